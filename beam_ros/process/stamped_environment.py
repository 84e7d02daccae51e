"""The virtual environment of a tree, and the stamp in it that says what it was made from.

As long as the stamp says what a call asks for, nothing is installed and nothing is looked up: the command starts at
once, without a network. A stamp that is incomplete, or half written, is that of an interrupted set-up: what that has
left is removed. A folder without a stamp is somebody else's.

Only the standard library is imported here: there is nothing else yet.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from beam_ros.errors import InstallationError
from beam_ros.process import environment as processes
from beam_ros.process.installation import Installation, alone
from beam_ros.process.strict_json import strict_json

STAMP = "beam-setup.json"

_ORIGINS = {"wheels": "ROS 2 Jazzy from wheels", "system": "the sourced ROS 2 Jazzy", "none": "without ROS"}
_NOT_FOR_CHILDREN = (
    "PYTHONHOME",
    "PIP_TARGET",
    "PIP_PREFIX",
    "PIP_USER",
    "UV_SYSTEM_PYTHON",
    "__PYVENV_LAUNCHER__",
)


class StampedEnvironment:
    """A tree's environment; its wishes are the keywords ``extras``, ``requested`` and ``constraint``.

    Parameters
    ----------
    root : str -- folder of the tree
    venv : str -- folder of the environment, seen from the tree
    sourced : str -- what tells one sourced ROS 2 from another; empty when none is sourced
    say : callable -- tells the person what happens

    Attributes
    ----------
    venv : Path -- the folder
    scripts : Path -- folder of its commands
    """

    def __init__(self, root: str, venv: str, sourced: str, say: Callable[[str], None]) -> None:
        self._root, self._sourced, self._say = Path(root), sourced, say
        self.venv = self._root / venv
        self.scripts = self.venv / ("Scripts" if os.name == "nt" else "bin")
        self._python = self.scripts / ("python.exe" if os.name == "nt" else "python")

    def stamp(self) -> dict[str, Any]:
        """What the environment was made from; empty when there is none of ours."""
        try:
            stamp = json.loads((self.venv / STAMP).read_text())
        except (OSError, ValueError):
            return {}
        return stamp if isinstance(stamp, dict) else {}

    def is_ready(self, *, extras: set[str], requested: str, constraint: str) -> bool:
        """Whether the environment is what this call asks for.

        Parameters
        ----------
        extras : set of str -- of setup.py
        requested : str -- an interpreter's path, name or version; empty where none was named
        constraint : str -- file of versions to hold to, seen from the tree; or empty

        Raises
        ------
        InstallationError -- the constraints cannot be read
        """
        stamp = self.stamp()
        return (
            self._is_whole(stamp)
            and all(stamp.get(name) == value for name, value in self.sources(constraint).items())
            and extras <= set(stamp["extras"])
            and requested in ("", stamp["requested"], stamp["python"])
            and ("ros" not in extras or stamp["sourced"] == self._sourced)
        )

    def make(
        self, *, extras: set[str], requested: str, constraint: str, source: str, numpy_version: str
    ) -> None:
        """Create the environment with the interpreter that runs this, or bring it up to date.

        Parameters
        ----------
        extras, requested, constraint -- as for ``is_ready``
        source : str -- where ROS 2 comes from: "system", "wheels" or "none"
        numpy_version : str -- NumPy's beside a sourced ROS 2, or empty

        Raises
        ------
        InstallationError -- one line with its remedy
        """
        with alone(self._root):
            if self.is_ready(extras=extras, requested=requested, constraint=constraint):
                return  # Another call has made it meanwhile.
            old, python, sources = self.stamp(), os.path.realpath(sys.executable), self.sources(constraint)
            is_usable = (
                self._is_whole(old)
                and old["python"] == python
                and (source in ("none", old["source"]) or (source, old["source"]) == ("wheels", "none"))
            )
            if is_usable:
                extras = extras | set(old["extras"])
                source = old["source"] if source == "none" else source
            stamp = sources | {"extras": sorted(extras), "requested": requested, "python": python}
            stamp |= {"source": source, "sourced": self._sourced}
            if not is_usable or any(old.get(name) != stamp[name] for name in (*sources, "extras")):
                started, version = time.monotonic(), sys.version.partition(" ")[0]
                doing = "Bringing up to date" if is_usable else "Setting up"
                self._say(
                    f"{doing} {self.venv.name} (Python {version}, {_ORIGINS[source]}). This is done once."
                )
                if not is_usable:
                    self._remove_own()
                self._write(stamp)
                installation = Installation(self._root, self.venv, self._environment(source), self._say)
                if not is_usable:
                    installation.create(sees_system=source == "system")
                installation.install(stamp["extras"], source, constraint, numpy_version)
                self._say(f"Set up in {time.monotonic() - started:.0f} s.")
            self._write(stamp | {"link": os.path.realpath(self._python), "is_complete": True})

    def start(self, command: list[str]) -> int:
        """Become the command.

        Raises
        ------
        InstallationError -- there is no such command
        """
        environment = self._environment(self.stamp()["source"])
        path = shutil.which(command[0], path=environment["PATH"])
        if not path:
            raise InstallationError(
                f"no command {command[0]!r} in {self.scripts} or on PATH; expected for instance `beam demo`"
            )
        if os.name != "nt":
            sys.stdout.flush()
            os.execve(path, [path, *command[1:]], environment)
        return subprocess.call([path, *command[1:]], env=environment)

    def sources(self, constraint: str) -> dict[str, Any]:
        """Part of the stamp that must be as the tree is now."""
        packages = sorted(path.parent.name for path in self._root.glob("*/__init__.py"))
        files = ["setup.py", *([constraint] if constraint else [])]
        digests = [_digest(self._root / file) for file in files]
        return {"format": 2, "venv": str(self.venv), "packages": packages, "digests": digests}

    def _is_whole(self, stamp: dict[str, Any]) -> bool:
        """Whether the stamp's environment is there, and of the interpreter that the system had then."""
        return (
            stamp.get("is_complete") is True
            and stamp.get("venv") == str(self.venv)
            and (self.scripts / ("beam.exe" if os.name == "nt" else "beam")).exists()
            and self._python.exists()
            and os.path.realpath(self._python) == stamp.get("link", stamp.get("python"))
        )

    def _write(self, stamp: dict[str, Any]) -> None:
        (self.venv / STAMP).write_text(strict_json(stamp, indent=1))

    def _remove_own(self) -> None:
        """Leave an empty folder where a set-up made an environment; refuse to touch any other."""
        if self.venv.is_dir() and any(self.venv.iterdir()):
            if not (self.venv / STAMP).exists():
                raise InstallationError(
                    f"{self.venv} exists and was not made by this script; expected no such folder; move it away or "
                    "choose another with --venv"
                )
            self._say("Removing what an earlier set-up left.")
            shutil.rmtree(self.venv)
        self.venv.mkdir(parents=True, exist_ok=True)

    def _environment(self, source: str) -> dict[str, str]:
        """Variables for the installer and for the command, with this environment first."""
        variables = dict(os.environ)
        if source == "wheels":
            variables = processes.without_foreign_ros(variables, prefix=self.venv)
            variables.pop(processes.WHEELS_GUARD, None)
        for name in _NOT_FOR_CHILDREN:
            variables.pop(name, None)
        path = os.pathsep.join([str(self.scripts), variables.get("PATH", os.defpath)])
        return variables | {"VIRTUAL_ENV": str(self.venv), "PATH": path}


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as err:
        raise InstallationError(
            f"{path} cannot be read ({err.strerror}); expected a file of this tree or of pip's constraints"
        ) from err
