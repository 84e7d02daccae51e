"""The demo: the whole experiment over ROS 2, conducted from one process, each node a process of its own.

It needs real time, which a busy computer may not have. What came too late is tried again, and at last the core of
``beam simulate`` makes the same experiment, so that there is a report in any case, which says how it was made.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from beam_ros.errors import RigUnavailableError
from beam_ros.excitation.plan import plan_excitation
from beam_ros.interfaces.graph import RigKind, emulated_port, nodes_of_rig
from beam_ros.launching.attempts import Attempt, DemoOutcome, Failure, persist
from beam_ros.launching.client import RigClient
from beam_ros.launching.processes import (
    NodeGroup,
    PrivateDomain,
    node_arguments,
    stay_on_this_machine,
)
from beam_ros.launching.recording import PATIENT_WATCHDOG_S, START_TIMEOUT_S, measure, node_ends, wait_for_rig
from beam_ros.process.folders import make_folder
from beam_ros.process.progress import Progress
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import check_time_of_rig

NOT_SHOWN = {
    RigKind.SIMULATED: "the nodes, their messages over ROS 2, real time, the camera's frames and the tracker",
    RigKind.EMULATED: "the nodes, their messages over ROS 2, real time, the serial line and the firmware behind it, "
    "the camera's frames and the tracker",
}
"""What a bag of the core leaves out of the experiment, by the rig that was asked for."""

_IDENTIFY_GUARD_S = 900.0
"""The fit has no real time to keep: this long it may take on a busy computer [s]."""
_USUAL_IDENTIFY_S = 90.0
_MAX_START_DELAY_S = 60.0


def conduct_demo(
    rig: Rig,
    kind: RigKind,
    folder: Path,
    stand_in: Callable[[Rig, Path], dict[str, Any]],
    *,
    record_images: bool = False,
) -> DemoOutcome:
    """Run the experiment and return its outcome.

    Parameters
    ----------
    rig : Rig -- parameters of the rig and its excitation
    kind : RigKind -- simulated or emulated
    folder : Path -- takes the bag, model.json and report.html
    stand_in : callable -- given rig and folder, makes the same experiment without nodes and returns its result
    record_images : bool -- record the camera's frames too

    Returns
    -------
    DemoOutcome -- with what the identifier published on ``identification/result``, or what stands in for it

    Raises
    ------
    UsageError
        The excitation leaves a limit, or the rig cannot keep the time that it is given.
    """
    check_time_of_rig(kind, rig)
    plan_excitation(rig)
    make_folder(folder)

    def carry_out(attempt: Attempt) -> dict[str, Any]:
        try:
            return _with_nodes(rig, kind, folder, attempt, record_images=record_images)
        except RigUnavailableError:
            _set_aside(folder, attempt)
            raise

    def do_without() -> dict[str, Any]:
        here = rig.with_values(_identifier_for_run(folder))
        here.write(folder / "rig.yaml")
        return stand_in(here, folder)

    return persist(carry_out, do_without, _tell)


def _tell(failure: Failure, next_step: str) -> None:
    """Say on the terminal what came to nothing, and what is done about it."""
    first, *more = failure.lines()
    print(f"attempt {failure.attempt.number:<16} {first}", file=sys.stderr)  # noqa: T201
    for line in (*more, next_step):
        print(f"{'':<24} {line}", file=sys.stderr, flush=True)  # noqa: T201


def _set_aside(folder: Path, attempt: Attempt) -> None:
    """Move what an attempt has left into a folder of its own."""
    aside = make_folder(folder / f"attempt-{attempt.number}")
    for path in sorted(folder.iterdir()):
        if not path.name.startswith("attempt-"):
            path.rename(aside / path.name)


def _with_nodes(
    rig: Rig, kind: RigKind, folder: Path, attempt: Attempt, *, record_images: bool
) -> dict[str, Any]:
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="beam-rig-")))
        domain = PrivateDomain()
        stack.callback(domain.release)
        stay_on_this_machine(os.environ, domain.number, scratch / "ros")
        rig_here = _rig_for_run(rig, kind, folder, scratch, attempt, record_images=record_images)
        nodes = stack.enter_context(NodeGroup(folder / "logs"))
        try:
            return _experiment(rig_here, kind, nodes, domain.number, attempt)
        finally:
            attempt.circumstances = nodes.load().sentence()
            _end(nodes)


def _rig_for_run(
    rig: Rig, kind: RigKind, folder: Path, scratch: Path, attempt: Attempt, *, record_images: bool
) -> Rig:
    """Fill in where this run records and reports, and how hub and emulator find each other."""
    start_delay = min(rig.excitation.start_delay * attempt.patience, _MAX_START_DELAY_S)
    changes: dict[str, Any] = {
        "recorder.path": str((folder / "bag").resolve()),
        "recorder.images": record_images,
        "recorder.start_at_launch": False,
        "excitation.start_delay": max(rig.excitation.start_delay, start_delay),
        **_identifier_for_run(folder),
    }
    if kind is RigKind.EMULATED:
        port = str(scratch / "controller")
        changes.update(emulated_port(port))
        # Nothing real moves here: a busy computer may delay the host without ending the demo.
        changes["hub.watchdog"] = max(rig.hub.watchdog, PATIENT_WATCHDOG_S)
    here = rig.with_values(changes)
    here.write(folder / "rig.yaml")
    return here


def _identifier_for_run(folder: Path) -> dict[str, Any]:
    return {
        "identifier.bag": str((folder / "bag").resolve()),
        "identifier.report": str(folder.resolve()),
        "identifier.overwrite": True,  # beside the bag, in the run's own folder
    }


def _experiment(rig: Rig, kind: RigKind, nodes: NodeGroup, domain: int, attempt: Attempt) -> dict[str, Any]:
    rig_file = nodes.log_folder.parent / "rig.yaml"
    start_timeout_s = START_TIMEOUT_S * attempt.patience
    with Progress("start", start_timeout_s, "s") as stage:
        rig_nodes = nodes_of_rig(kind, with_camera_images=rig.simulation.images)
        for executable in (*rig_nodes, "bag_recorder", "identifier"):
            nodes.start(executable, node_arguments(executable, rig, rig_file))
        with RigClient(nodes.check) as client:
            wait_for_rig(client, nodes.log_folder, start_timeout_s, stage.update)
            stage.finish(f"{len(nodes.nodes)} nodes on domain {domain}, this machine only")
            try:
                measure(rig, client, has_images=rig.simulation.images, patience=attempt.patience)
            finally:
                attempt.has_moved = client.has_moved
            attempt.circumstances = nodes.load().sentence()
            return _identify(client, nodes)


def _identify(client: RigClient, nodes: NodeGroup) -> dict[str, Any]:
    with Progress("identify", _USUAL_IDENTIFY_S, "s") as stage:
        result = client.identify(
            _IDENTIFY_GUARD_S,
            stage.update,
            # The rig has done its part, and would take the processors from the fit.
            on_begun=lambda: _end(nodes, but=("identifier",)),
        )
        if "error" in result:
            raise RigUnavailableError(f"identification failed: {result['error']}")
        stage.finish(f"{len(result['modes'])} modes from {', '.join(result['outputs'])}")
    return result


def _end(nodes: NodeGroup, *, but: tuple[str, ...] = ()) -> None:
    """End nodes, and say how they ended.

    Raises
    ------
    RigUnavailableError
        One did not end cleanly.
    """
    if not nodes.nodes:
        return
    with Progress("stop", 1.0) as stage:
        statuses = nodes.end(but=but)
        stage.finish(node_ends(statuses))
    if any(statuses.values()):
        raise RigUnavailableError(
            f"a node did not end cleanly: {node_ends(statuses)}; see {nodes.log_folder}"
        )
