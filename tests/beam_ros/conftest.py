"""Real nodes on a private ROS domain, and the `beam` command without the start of a process."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from beam_ros.cli.main import main
from tests.private_ros import executables, graph, private_ros

__all__ = ["beam", "executables", "graph", "private_ros"]

Ended = subprocess.CompletedProcess[str]
Beam = Callable[..., Ended]


@pytest.fixture(scope="session", autouse=True)
def _decoders_that_speak() -> None:
    """Load OpenCV's decoders before a verb keeps them quiet for its process: other tests hear their complaints."""
    with contextlib.suppress(ImportError):
        import cv2

        cv2.VideoCapture(os.devnull, cv2.CAP_FFMPEG)


@pytest.fixture
def beam(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Beam:
    """Run the command in the test's folder: `beam("info", "bag").stdout`."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Ended:
        status = main(list(arguments))
        printed = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, status, printed.out, printed.err)

    return run
