"""The command that compares the suite with its peers runs with NumPy and SciPy alone, and its table is the page's."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from benchmarks import peers

PAGE = Path(__file__).parents[2] / "docs" / "measured" / "peers.md"
HEADER = "| record | by | runs | failed | frequency, error / bound |"


@pytest.fixture
def nothing_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hide every peer, OpenCV and rosbags."""
    own = ("scipy",)

    def found(name: str) -> Any:
        return find_spec(name) if name in own else None

    monkeypatch.setattr(peers, "find_spec", found)
    for name in ("benchmarks.vision", "beam_ros.offline.loading.experiment"):
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.usefixtures("nothing_installed")
def test_numpy_and_scipy_are_enough_and_what_is_missing_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--runs", "1", "--records", "rao-garnier", "bag-decay", "camera"]
    assert peers.main(words) == 0
    table, winners, missing = capsys.readouterr().out.split("\n\n", 2)
    lines = table.splitlines()
    assert lines[0].startswith(HEADER)
    assert [line.split(" | ")[1] for line in lines[2:]] == [
        peer.title for peer in peers.PEERS if peer.package == "scipy"
    ]
    assert lines[2].split(" | ")[3] == "0"
    assert lines[2].endswith("| 1 |")
    assert "the suite, no start" in winners
    for name in ("pyidi", "pyOMA-2", "jax-sysid", "bag-decay", "camera", "CAPTAIN", "Julia"):
        assert name in missing


def test_a_peer_that_finds_no_pair_near_a_mode_has_failed() -> None:
    system = peers.rao_garnier_system()
    truth = peers.pairs_of(system.truth[:2], system.truth[2:])
    found = system.figures(truth)
    assert found is not None
    assert found == pytest.approx(system.truth)
    assert system.figures(truth[:1]) is None
    assert system.figures(truth * [1.2, 1.0]) is None
    lost = peers.Peer("none", "scipy", "scipy", ("force",), lambda s, r: truth[:1])
    assert peers.score(system, lost, 2).failures == 2


def test_the_page_holds_the_tables_of_the_command() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert HEADER in text
    assert "| record | nearest to the truth |" in text
    for peer in peers.PEERS:
        assert f"| {peer.title} |" in text, peer.title
