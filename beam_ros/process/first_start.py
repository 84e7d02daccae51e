"""The last step of an installation: the commands' first lines, and a first start of all that was installed.

``python -m beam_ros.process.first_start [nodes]`` is run by the set-up once everything is installed. The start shows
that everything can be imported on this machine. It also compiles that much and no more: otherwise the first
``beam demo`` would do so, in five processes at once.
"""

from __future__ import annotations

import importlib
import shlex
import subprocess
import sys
from pathlib import Path

from beam_ros.process.executables import MODULES

_BLOCKING = ("/usr/bin/env", "-S", "--block-signal=INT --block-signal=TERM")
_MAX_FIRST_LINE = 255
"""So many bytes of a script's first line Linux reads."""


def hold_signals_back(scripts: Path, python: str) -> None:
    """Let the suite's commands start with SIGINT and SIGTERM blocked, which they let in once they can take them.

    Python has its own handler long before a script's first line: a Ctrl-C in the first tenth of a second would
    end in a traceback of the interpreter's start.

    Parameters
    ----------
    scripts : Path -- folder of the commands that pip or uv has made; those of other packages stay as they are
    python : str -- path of the interpreter that runs them
    """
    line = f"#!{' '.join(_BLOCKING)} {shlex.quote(python)}\n".encode()
    if sys.platform != "linux" or "'" in python or len(line) > _MAX_FIRST_LINE:
        return
    if subprocess.call([*_BLOCKING, "true"], stderr=subprocess.DEVNULL):
        return  # an env older than 2019
    for path in filter(Path.is_file, scripts.iterdir()):
        first, _, body = path.read_bytes().partition(b"\n")
        if first.startswith(b"#!") and b"from beam_ros.process.executables import" in body:
            path.write_bytes(line + body)


def start_once(has_ros: bool) -> None:
    """Import what the commands import; the nodes only where there is a ROS 2.

    Raises
    ------
    ImportError -- something that was installed cannot be used on this machine
    """
    for name, module in MODULES.items():
        if has_ros or name == "beam":
            importlib.import_module(module)


if __name__ == "__main__":
    hold_signals_back(Path(sys.executable).parent, sys.executable)
    start_once(sys.argv[1:] == ["nodes"])
