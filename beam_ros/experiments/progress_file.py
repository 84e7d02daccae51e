"""What of an experiment is done: a file that is whole at every moment, with the checksum of everything that was made.

A step enters the file after its outputs are on the disk under their final names. Whatever else is in the folder when
the work goes on belongs to a step that did not end.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from beam_ident.report.page import write_whole
from beam_ros.errors import UsageError
from beam_ros.process.checksums import checksum
from beam_ros.process.strict_json import strict_json

STATE_FILE = "state.json"

_SCHEMA = 1


@dataclass(frozen=True)
class DoneStep:
    """A step that has ended.

    Attributes
    ----------
    files : mapping of str to str -- SHA-256 of every file, by its path in the experiment's folder
    said : str -- its result in a phrase
    """

    files: Mapping[str, str]
    said: str


@dataclass
class ProgressFile:
    """The state of an experiment in its folder.

    Attributes
    ----------
    folder : Path
    plan : str -- name of the plan
    digest : str -- of the plan
    begun : str -- when the experiment began, ISO 8601
    steps : dict of str to DoneStep -- in the order in which they ended
    """

    folder: Path
    plan: str
    digest: str
    begun: str
    steps: dict[str, DoneStep] = field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> ProgressFile | None:
        """Read the state of a folder; None where it holds no experiment.

        Raises
        ------
        UsageError
            The file is there, and is not one of this suite.
        """
        path = folder / STATE_FILE
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["schema"] != _SCHEMA:
                raise ValueError(f"schema {content['schema']}, expected {_SCHEMA}")
            steps = {
                str(name): DoneStep(dict(entry["files"]), str(entry["said"]))
                for name, entry in content["steps"].items()
            }
            return cls(folder, str(content["plan"]), str(content["digest"]), str(content["begun"]), steps)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as err:
            raise UsageError(
                f"{path}: cannot be read as the state of an experiment ({err}); give another --out, or move it away"
            ) from err

    def finish(self, step: str, outputs: tuple[str, ...], said: str) -> None:
        """Enter a step with the checksums of its outputs."""
        files = {
            path.relative_to(self.folder).as_posix(): checksum(path)
            for output in outputs
            for path in files_below(self.folder / output)
        }
        self.steps[step] = DoneStep(files, said)
        self.write()

    def write(self) -> None:
        """Write the file, which is the old one or the new one at every moment."""
        content: dict[str, Any] = {
            "schema": _SCHEMA,
            "plan": self.plan,
            "digest": self.digest,
            "begun": self.begun,
            "steps": {
                name: {"said": step.said, "files": dict(step.files)} for name, step in self.steps.items()
            },
        }
        write_whole(self.folder / STATE_FILE, strict_json(content, indent=1))

    def verify(self) -> None:
        """Raise where something that a finished step made is gone or changed.

        Raises
        ------
        UsageError
            Names the file and the step.
        """
        for name, step in self.steps.items():
            for file, expected in step.files.items():
                path = self.folder / file
                what = (
                    "is gone" if not path.is_file() else "has changed" if checksum(path) != expected else ""
                )
                if what:
                    raise UsageError(
                        f"{path}: {what} since the step {name!r} made it: expected SHA-256 {expected[:16]}..; put it "
                        "back, or begin anew with --overwrite or another --out"
                    )


def files_below(path: Path) -> list[Path]:
    """Return a file, or all files in a folder, in the order of their names."""
    return [path] if path.is_file() else sorted(own for own in path.rglob("*") if own.is_file())
