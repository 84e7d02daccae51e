"""Run a node and note which parameters of the rig it reads: `reading_node.py EXECUTABLE FILE --ros-args ...`."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import fields
from pathlib import Path


def watch(reads: set[str]) -> None:
    """Note every field of a group that is read, but for what goes through the whole table to check or declare it."""
    from beam_ros.interfaces.rig_parameters import GROUPS, RigParameters
    from beam_ros.rig import rig as room

    paused: list[str] = []

    def pausing(function):
        def call(*arguments):
            paused.append(function.__name__)
            try:
                return function(*arguments)
            finally:
                paused.pop()

        return call

    def spy(group, names):
        def read(self, name):
            if name in names and not paused:
                reads.add(f"{group}.{name}")
            return object.__getattribute__(self, name)

        return read

    room.check_relations = pausing(room.check_relations)
    RigParameters.__getitem__ = pausing(RigParameters.__getitem__)
    for group, settings in GROUPS.items():
        settings.__getattribute__ = spy(group, {field.name for field in fields(settings)})


def main() -> int:
    """Run the node, then write what it has read as a JSON list."""
    from beam_ros.process.executables import run_executable

    executable, path, *arguments = sys.argv[1:]
    reads: set[str] = set()
    watch(reads)
    try:
        return run_executable(executable, arguments)
    finally:
        with contextlib.suppress(OSError):
            Path(path).write_text(json.dumps(sorted(reads)))


if __name__ == "__main__":
    sys.exit(main())
