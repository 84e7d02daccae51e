"""`beam identify` as a process of its own, interrupted."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")

BAG = Path(__file__).resolve().parents[4] / "bags" / "chirp_6s"
BEAM = Path(sys.executable).with_name("beam")


@pytest.mark.slow
def test_ctrl_c_in_the_middle_writes_the_model_so_far_and_says_what_is_missing(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()  # on a terminal, of a size, every phrase of the progress is shown
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 120, 0, 0))
    process = subprocess.Popen(
        [str(BEAM), "identify", str(BAG), "--report", str(tmp_path / "report")],
        stdout=subprocess.PIPE,
        stderr=theirs,
        text=True,
    )
    os.close(theirs)
    shown = b""
    try:
        # From the second mode on there is one to keep.
        while not re.search(rb"looking for mode [2-9]|weighing", shown):
            shown += os.read(ours, 4096)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60.0)
    finally:
        process.kill()
        os.close(ours)
    assert process.returncode == 0
    assert "interrupted; missing is" in said
    model = json.loads((tmp_path / "report" / "model.json").read_text())
    assert "interrupted; missing is" in json.dumps(model)
    assert "interrupted; missing is" in (tmp_path / "report" / "report.html").read_text()
