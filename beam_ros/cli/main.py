"""Entry of the ``beam`` command: finds the verb, runs it, and turns a fault of the user's into one line.

Verbs are imported only when they are asked for, so that ``beam --help`` starts at once and nothing pulls in
ROS, OpenCV or matplotlib before it is needed.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import keyword
import os
import re
import sys
from collections.abc import Callable
from typing import NoReturn

from beam_ros.errors import faults_of_the_user, suggestion
from beam_ros.process.executables import INTERRUPTED
from beam_ros.process.interruption import interrupt, signals_taken

LIVE: dict[str, str] = {
    "demo": "the whole experiment without hardware: simulate, excite, film, track, record, identify, report",
    "experiment": "excitations, recordings, identification and validation as one plan, resumable, with one report",
    "thesis": "the reference work, reproduced: its tables and figures from bags, numbered as there",
    "up": "the rig's nodes together, until Ctrl-C",
    "view": "the running rig, or a recorded bag, on a page in the browser; stop is its only control",
    "run": "one node, as `ros2 run beam_ros NODE`",
    "call": "a service of the running rig: home, enable, start the excitation, stop",
    "record": "every topic of a running rig into a bag",
    "replay": "a bag back onto its topics, without what moves an axis",
}
"""Verbs that run nodes on the ROS graph."""

OFFLINE: dict[str, str] = {
    "model": "the rig's theory: frequencies, damping, participation; its beam from identified modes; all parameters",
    "design": "the excitation against the hub's limits and the beam's modes; --optimal finds the best one",
    "shape": "the shortest move that leaves less swing than an aim, with what it is predicted to leave",
    "simulate": "the simulator's core straight into a bag, without DDS",
    "recover": "a valid bag from what can be read of a damaged one",
    "info": "what a bag holds: topics, samples, gaps, clocks, excitation",
    "import": "a file of columns (CSV, MAT, NPZ, UFF, TDMS) as a bag with its provenance",
    "export": "a bag as CSV files or a flat bag; a model for MATLAB, FMI, Modelica, MuJoCo, printers and others",
    "render": "a film of the simulated experiment with a camera's faults, and its truth",
    "track": "displacements from a camera that only leaves a file, into the bag of its experiment",
    "calibrate": "pixels to metres, from a recorded bag or a board in the beam's plane; the camera's noise",
    "axis": "a motion controller on its line: what answers there, does its firmware keep the protocol",
}
"""Verbs that need no ROS graph."""

RESULTS: dict[str, str] = {
    "check": "whether a bag can be identified, and if not why: a table of gates with figures and remedies",
    "identify": "a continuous-time model from a bag, by one of several estimators",
    "compare": "bags and models side by side: poles, the significance of differences, responses",
    "study": "many bags, one row each in one table, on the cores or on a cluster",
}
"""Verbs that need no ROS graph either, and judge or identify bags."""

VERBS = {**LIVE, **OFFLINE, **RESULTS}

OK, FAULT_OF_THE_USER = 0, 2


class _Parser(argparse.ArgumentParser):
    """Parser whose refusals are one line, and whose help may end with what is looked up only then."""

    listing: Callable[[], str] | None = None

    def format_help(self) -> str:
        if self.listing is not None:
            self.epilog = self.listing()
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        remedy = f"`{self.prog} --help` shows what is expected"
        if bare := re.match(r"unrecognized arguments: .*?(\S+:=\S*)", message):
            remedy = f"a parameter is given as `-p {bare.group(1)}`; {remedy}"
        self.exit(FAULT_OF_THE_USER, f"{self.prog}: {message}; {remedy}\n")


def verb_parser(verb: str) -> argparse.ArgumentParser:
    """Return the parser of one verb."""
    room = "live" if verb in LIVE else "offline" if verb in OFFLINE else "results"
    name = f"{verb}_" if keyword.iskeyword(verb) else verb
    module = importlib.import_module(f"beam_ros.cli.{room}.{name}")
    parser = _Parser(
        prog=f"beam {verb}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.listing = getattr(module, "epilog", None)
    module.add_arguments(parser)
    parser.set_defaults(run=module.run)
    return parser


def _overview() -> str:
    width = max(map(len, VERBS))

    def lines(verbs: dict[str, str]) -> list[str]:
        return [f"    beam {verb:<{width}}   {meaning}" for verb, meaning in verbs.items()]

    return "\n".join(
        (
            "usage: beam VERB ...",
            "",
            "Identify a flexible cantilever beam on a moving hub, with or without hardware.",
            "",
            "With the rig's nodes:",
            *lines(LIVE),
            "",
            "Without them:",
            *lines(OFFLINE),
            "",
            "From bags to results:",
            *lines(RESULTS),
            "",
            "`beam VERB --help` explains a verb. Start with `beam demo`.",
        )
    )


def main(argv: list[str] | None = None) -> int:
    """Run the ``beam`` command.

    Parameters
    ----------
    argv : list of str, optional -- arguments without the program's name; by default the process's own

    Returns
    -------
    int -- 0 on success, 2 for a fault of the user's, 130 after Ctrl-C
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_overview())
        return OK if arguments else FAULT_OF_THE_USER
    if arguments[0] == "--version":
        from importlib.metadata import version

        print(f"beam {version('beam_ros')}")
        return OK
    verb, *rest = arguments
    if verb not in VERBS:
        print(
            f"beam: unknown verb {verb!r} ({suggestion(verb, VERBS)}); `beam --help` explains them",
            file=sys.stderr,
        )
        return FAULT_OF_THE_USER
    faults = faults_of_the_user()
    try:
        parsed = verb_parser(verb).parse_args(rest)
        with signals_taken(interrupt):
            return int(parsed.run(parsed))
    except SystemExit as exit_request:
        return int(exit_request.code or 0)
    except KeyboardInterrupt:
        print(f"beam {verb}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except faults as err:
        print(f"beam {verb}: {err}", file=sys.stderr)
        return FAULT_OF_THE_USER
    except BrokenPipeError:
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
