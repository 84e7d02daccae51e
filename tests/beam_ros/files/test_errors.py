"""A file of another program whose reader is not installed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from beam_ros.files.errors import ColumnFileError
from beam_ros.files.tdms_files import TdmsFile
from beam_ros.files.universal_files import UniversalFile


@pytest.mark.parametrize(("kind", "module"), [(TdmsFile, "nptdms"), (UniversalFile, "pyuff")])
def test_a_format_whose_reader_is_missing_says_which_extra_brings_it(
    kind: type, module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        ColumnFileError, match=r"^a\.bin: is a .* reads; install .* `files` extra, or .*table"
    ):
        kind(Path("a.bin"))
