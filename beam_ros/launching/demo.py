"""The demo: the whole experiment over ROS 2, conducted from one process, each node a process of its own."""

from __future__ import annotations

import os
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from beam_ros.errors import RigUnavailableError
from beam_ros.excitation.plan import plan_excitation
from beam_ros.interfaces.graph import RigKind, emulated_port, nodes_of_rig
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

_IDENTIFY_TIMEOUT_S = 90.0


def conduct_demo(rig: Rig, kind: RigKind, folder: Path, *, record_images: bool = False) -> dict[str, Any]:
    """Run the experiment and return its result.

    Parameters
    ----------
    rig : Rig -- parameters of the rig and its excitation
    kind : RigKind -- simulated or emulated
    folder : Path -- takes the bag, model.json and report.html
    record_images : bool -- record the camera's frames too

    Returns
    -------
    dict -- what the identifier published on ``identification/result``

    Raises
    ------
    RigUnavailableError
        A node fell, did not answer or refused.
    """
    check_time_of_rig(kind, rig)
    plan = plan_excitation(rig)
    factor = rig.simulation.real_time_factor
    length_s = (rig.excitation.start_delay + plan.sampled.duration_s) / factor
    make_folder(folder)
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="beam-rig-")))
        domain = PrivateDomain()
        stack.callback(domain.release)
        stay_on_this_machine(os.environ, domain.number, scratch / "ros")
        rig_here = _rig_for_run(rig, kind, folder, scratch, record_images)
        nodes = stack.enter_context(NodeGroup(folder / "logs"))
        try:
            result = _experiment(rig_here, kind, nodes, domain.number, length_s)
        finally:
            with Progress("stop", 1) as stage:
                statuses = nodes.end()
                stage.finish(node_ends(statuses))
        if any(statuses.values()):
            raise RigUnavailableError(f"a node did not end cleanly: {node_ends(statuses)}; see {folder}/logs")
    return result


def _rig_for_run(rig: Rig, kind: RigKind, folder: Path, scratch: Path, record_images: bool) -> Rig:
    """Fill in where this run records and reports, and how hub and emulator find each other."""
    changes: dict[str, Any] = {
        "recorder.path": str((folder / "bag").resolve()),
        "recorder.images": record_images,
        "recorder.start_at_launch": False,
        "identifier.bag": str((folder / "bag").resolve()),
        "identifier.report": str(folder.resolve()),
        "identifier.overwrite": True,  # beside the bag, in the run's own folder
    }
    if kind is RigKind.EMULATED:
        port = str(scratch / "controller")
        changes.update(emulated_port(port))
        # Nothing real moves here: a busy computer may delay the host without ending the demo.
        changes["hub.watchdog"] = max(rig.hub.watchdog, PATIENT_WATCHDOG_S)
    here = rig.with_values(changes)
    here.write(folder / "rig.yaml")
    return here


def _experiment(rig: Rig, kind: RigKind, nodes: NodeGroup, domain: int, length_s: float) -> dict[str, Any]:
    rig_file = nodes.log_folder.parent / "rig.yaml"
    with Progress("start", START_TIMEOUT_S, "s") as stage:
        rig_nodes = nodes_of_rig(kind, with_camera_images=rig.simulation.images)
        for executable in (*rig_nodes, "bag_recorder", "identifier"):
            nodes.start(executable, node_arguments(executable, rig, rig_file))
        with RigClient(nodes.check) as client:
            wait_for_rig(client, nodes.log_folder, START_TIMEOUT_S, stage.update)
            stage.finish(f"{len(nodes.nodes)} nodes on domain {domain}, this machine only")
            measure(rig, client, length_s, has_images=rig.simulation.images)
            return _identify(client)


def _identify(client: RigClient) -> dict[str, Any]:
    with Progress("identify", _IDENTIFY_TIMEOUT_S, "s") as stage:
        result = client.identify(_IDENTIFY_TIMEOUT_S, stage.update)
        if "error" in result:
            raise RigUnavailableError(f"identification failed: {result['error']}")
        stage.finish(f"{len(result['modes'])} modes from {', '.join(result['outputs'])}")
    return result
