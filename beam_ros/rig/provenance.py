"""How a recording comes about: versions, machine, people, rig, camera, calibration, as texts that a bag carries."""

from __future__ import annotations

import contextlib
import getpass
import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig

_GIT_PATIENCE_S = 2.0
_MAX_CALIBRATION = 64 * 1024
"""A file longer than this [bytes] is no calibration; its name alone is kept."""


def provenance(rig: Rig, operator: str = "") -> dict[str, str]:
    """Return what can be said of a recording that is about to begin.

    Parameters
    ----------
    rig : Rig -- all parameters in force
    operator : str -- who runs the experiment; empty: the user of the machine

    Returns
    -------
    dict of str to str -- what is not known is left out
    """
    # A recorder obeys none of these parameters: it hands the whole table on.
    tree = rig.to_nested()
    calibration = str(tree["tracker"]["calibration"])
    said = {
        **machine_provenance(operator),
        "rig": strict_json(tree),
        "camera": str(tree["camera"]["name"]),
        "lens": str(tree["camera"]["focus"]),
        "calibration_file": calibration,
        "calibration": _text_of(calibration),
    }
    return {name: text for name, text in said.items() if text}


def machine_provenance(operator: str = "") -> dict[str, str]:
    """Return who works on which machine with which versions; what is not known is left out.

    Parameters
    ----------
    operator : str -- who answers for it; empty: the user of the machine
    """
    said = {
        "operator": operator or _user(),
        "host": platform.node(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "ros": os.environ.get("ROS_DISTRO", ""),
        **{name: _version(name) for name in ("beam_ros", "numpy", "rclpy", "mcap")},
        "git": git_state(Path(__file__).resolve().parent),
    }
    return {name: text for name, text in said.items() if text}


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return ""


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def git_state(folder: Path) -> str:
    """Return the commit of the source tree, and whether it was changed since; empty where it is none."""
    answers = []
    for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no")):
        try:
            answers.append(
                subprocess.run(
                    ["git", "-C", str(folder), *words],
                    capture_output=True,
                    text=True,
                    timeout=_GIT_PATIENCE_S,
                    check=True,
                ).stdout.strip()
            )
        except (OSError, subprocess.SubprocessError):
            return ""
    return f"{answers[0]}{' with changes' if answers[1] else ''}"


def _text_of(path: str) -> str:
    with contextlib.suppress(OSError, UnicodeDecodeError, ValueError):
        if path and Path(path).stat().st_size <= _MAX_CALIBRATION:
            return Path(path).read_text(encoding="utf-8")
    return ""
