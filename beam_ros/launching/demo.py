"""The demo: the whole experiment over ROS 2, conducted from one process, each node a process of its own."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from beam_ros.errors import RigUnavailableError
from beam_ros.excitation.plan import plan_excitation
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.interfaces.graph import RigKind, emulated_port, nodes_of_rig
from beam_ros.launching.client import RigClient
from beam_ros.launching.processes import (
    NodeGroup,
    PrivateDomain,
    node_arguments,
    stay_on_this_machine,
)
from beam_ros.process.folders import make_folder
from beam_ros.process.progress import Progress
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import check_time_of_rig

_START_TIMEOUT_S = 30.0
_IDENTIFY_TIMEOUT_S = 90.0
_CLOCK_TIMEOUT_S = 30.0
_PATIENT_WATCHDOG_S = 1.0


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
                stage.finish(_ends(statuses))
        if any(statuses.values()):
            raise RigUnavailableError(f"a node did not end cleanly: {_ends(statuses)}; see {folder}/logs")
    return result


def _ends(statuses: Mapping[str, int]) -> str:
    failed = [f"{name} ended with status {status}" for name, status in statuses.items() if status]
    return ", ".join(failed) or f"{len(statuses)} nodes ended with status 0"


def _rig_for_run(rig: Rig, kind: RigKind, folder: Path, scratch: Path, record_images: bool) -> Rig:
    """Fill in where this run records and reports, and how hub and emulator find each other."""
    changes: dict[str, Any] = {
        "recorder.path": str((folder / "bag").resolve()),
        "recorder.images": record_images,
        "recorder.start_at_launch": False,
        "identifier.bag": str((folder / "bag").resolve()),
        "identifier.report": str(folder.resolve()),
    }
    if kind is RigKind.EMULATED:
        port = str(scratch / "controller")
        changes.update(emulated_port(port))
        # Nothing real moves here: a busy computer may delay the host without ending the demo.
        changes["hub.watchdog"] = max(rig.hub.watchdog, _PATIENT_WATCHDOG_S)
    here = rig.with_values(changes)
    here.write(folder / "rig.yaml")
    return here


def _experiment(rig: Rig, kind: RigKind, nodes: NodeGroup, domain: int, length_s: float) -> dict[str, Any]:
    rig_file = nodes.log_folder.parent / "rig.yaml"
    with Progress("start", _START_TIMEOUT_S, "s") as stage:
        rig_nodes = nodes_of_rig(kind, with_camera_images=rig.simulation.images)
        for executable in (*rig_nodes, "bag_recorder", "identifier"):
            nodes.start(executable, node_arguments(executable, rig, rig_file))
        client = RigClient(nodes.check)
        with client:
            client.wait(
                lambda: bool(client.displacement) and not math.isnan(client.hub_position),
                _START_TIMEOUT_S,
                "neither hub/state nor beam/displacement arrived",
                f"look at the nodes' logs in {nodes.log_folder}",
                stage.update,
            )
            stage.finish(f"{len(nodes.nodes)} nodes on domain {domain}, this machine only")
            return _measure_and_identify(rig, client, length_s)


def _measure_and_identify(rig: Rig, client: RigClient, length_s: float) -> dict[str, Any]:
    with Progress("home and enable", 30.0, "s") as stage:
        client.call("hub/home", timeout_s=30.0)
        if rig.simulation.images:
            client.call("tracker/tare")
        client.call("hub/enable", value=True)
        client.wait(
            client.is_clock_settled,
            _CLOCK_TIMEOUT_S,
            "the device's clock was not mapped to 50 us",
            "end other programs that take the processor",
            stage.update,
        )
        stage.finish(
            f"hub at {client.hub_position * 1e3:+.3f} mm, markers {', '.join(client.displacement)} in sight"
        )
    client.call("recorder/start")
    client.wait(
        lambda: all(client.recorded.get(topic, 0) > 0 for topic in ("hub/measured", "beam/displacement")),
        _START_TIMEOUT_S,
        "the recorder received nothing from hub and tracker",
        "look at bag_recorder.log",
    )
    with Progress(rig.excitation.kind, length_s, "s") as stage:
        client.sequence = {}
        client.call("excitation/start", timeout_s=30.0)
        client.wait(
            lambda: client.sequence.get("state") not in (None, "loading", "ready"),
            30.0,
            "the sequence did not start",
            "hub/sequence_state says how far it came",
        )
        client.wait(
            lambda: client.sequence["state"] != "running",
            length_s + 30.0,
            "the sequence did not end",
            "look at hub/sequence_state",
            lambda elapsed_s: stage.update(elapsed_s, _live(client)),
        )
        if client.sequence["state"] != "done":
            raise RigUnavailableError(
                f"the sequence ended as {client.sequence['state']}: {client.sequence['reason']}; expected done"
            )
        stage.finish(
            f"{recipe_of_rig(rig).total_s - rig.excitation.still:g} s of excitation, then "
            f"{rig.excitation.still:g} s still"
        )
    with Progress("record", 1.0) as stage:
        recorded = client.call("recorder/stop")
        client.call("hub/enable", value=False)
        stage.finish(recorded)
    with Progress("identify", _IDENTIFY_TIMEOUT_S, "s") as stage:
        result = client.identify(_IDENTIFY_TIMEOUT_S, stage.update)
        if "error" in result:
            raise RigUnavailableError(f"identification failed: {result['error']}")
        stage.finish(f"{len(result['modes'])} modes from {', '.join(result['outputs'])}")
    return result


def _live(client: RigClient) -> str:
    *_, tip = client.displacement.values()
    return f"hub {client.hub_position * 1e3:+7.3f} mm   tip marker {tip * 1e3:+7.2f} mm"
