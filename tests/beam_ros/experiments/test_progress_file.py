"""The state of an experiment: whole at every moment, and never wrong about what it lists."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.errors import UsageError
from beam_ros.experiments.progress_file import STATE_FILE, ProgressFile


def begun(folder: Path) -> ProgressFile:
    (folder / "bags" / "E1").mkdir(parents=True)
    (folder / "bags" / "E1" / "E1_0.mcap").write_bytes(b"samples")
    state = ProgressFile(folder, "plan", "digest", "now")
    state.finish("record E1", ("bags/E1",), "20 s of chirp")
    return state


def test_it_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    assert ProgressFile.read(tmp_path) is None
    state = begun(tmp_path)
    assert ProgressFile.read(tmp_path) == state
    assert list(state.steps["record E1"].files) == ["bags/E1/E1_0.mcap"]
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == [STATE_FILE]


@pytest.mark.parametrize(("content", "words"), [(b"Samples", "has changed"), (None, "is gone")])
def test_what_a_finished_step_made_must_be_there_unchanged(
    tmp_path: Path, content: bytes | None, words: str
) -> None:
    state = begun(tmp_path)
    state.verify()
    file = tmp_path / "bags" / "E1" / "E1_0.mcap"
    file.unlink()
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(UsageError, match=f"E1_0.mcap: {words} since the step 'record E1'"):
        state.verify()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": 99}', '{"schema": 1, "steps": 3}'])
def test_a_file_that_is_no_state_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / STATE_FILE).write_text(text)
    with pytest.raises(UsageError, match="cannot be read as the state of an experiment"):
        ProgressFile.read(tmp_path)
