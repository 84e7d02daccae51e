"""One recording on a running rig: its nodes as processes, from homing to the closed bag."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from beam_ros.errors import RigUnavailableError
from beam_ros.excitation.plan import plan_excitation
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.excitation.start_lead import first_lead, longest_wait
from beam_ros.interfaces.graph import RigKind, emulated_port, nodes_of_rig
from beam_ros.launching.client import RigClient
from beam_ros.launching.processes import NodeGroup, PrivateDomain, node_arguments, stay_on_this_machine
from beam_ros.process.progress import Progress
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import check_time_of_rig
from beam_ros.shell.other_hubs import reach

START_TIMEOUT_S = 30.0
PATIENT_WATCHDOG_S = 1.0
"""Of an emulated axis: nothing real moves, and a busy computer may delay the host."""

_CLOCK_TIMEOUT_S = 30.0
_ANSWER_TIMEOUT_S = 30.0


def record_live(rig: Rig, kind: RigKind, bag: Path, logs: Path) -> None:
    """Start a rig's nodes, run its excitation, record it, and end the nodes.

    Parameters
    ----------
    rig : Rig -- with the excitation
    kind : RigKind -- a real rig is on the domain of the environment, all else on a private one
    bag : Path -- the bag's folder; must not exist
    logs : Path -- folder for what the nodes print

    Raises
    ------
    RigUnavailableError
        A node fell, did not answer or refused; a hub is on the graph already.
    """
    check_time_of_rig(kind, rig)
    plan_excitation(rig)
    has_images = kind is not RigKind.SIMULATED or rig.simulation.images
    changes: dict[str, Any] = {"recorder.path": str(bag.resolve()), "recorder.start_at_launch": False}
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="beam-rig-")))
        if kind is not RigKind.REAL:
            domain = PrivateDomain()
            stack.callback(domain.release)
            stay_on_this_machine(os.environ, domain.number, scratch / "ros")
        if kind is RigKind.EMULATED:
            changes |= emulated_port(str(scratch / "controller"))
            changes["hub.watchdog"] = max(rig.hub.watchdog, PATIENT_WATCHDOG_S)
        here = rig.with_values(changes)
        rig_file = scratch / "rig.yaml"
        here.write(rig_file)
        client = stack.enter_context(RigClient())
        if kind is RigKind.REAL:
            client.refuse_live_hub()
        nodes = stack.enter_context(NodeGroup(logs))
        client.check = nodes.check
        with Progress("start", START_TIMEOUT_S, "s") as stage:
            for executable in (*nodes_of_rig(kind, with_camera_images=has_images), "bag_recorder"):
                nodes.start(executable, node_arguments(executable, here, rig_file))
            wait_for_rig(client, logs, START_TIMEOUT_S + rig.serial.patience, stage.update)
            stage.finish(f"{len(nodes.nodes)} nodes, {reach()}")
        measure(here, client, has_images=has_images)
        statuses = nodes.end()
        if any(statuses.values()):
            raise RigUnavailableError(f"a node did not end cleanly: {node_ends(statuses)}; see {logs}")


def wait_for_rig(client: RigClient, logs: Path, timeout_s: float, on_tick: Callable[[float], None]) -> None:
    """Wait until the hub and the markers are heard of.

    Raises
    ------
    RigUnavailableError
        They are not in time, or a node has fallen.
    """
    client.wait(
        lambda: bool(client.displacement) and client.is_hub_heard(),
        timeout_s,
        "neither hub/state nor beam/displacement arrived",
        f"look at the nodes' logs in {logs}",
        on_tick,
    )


def measure(rig: Rig, client: RigClient, *, has_images: bool, patience: float = 1.0) -> None:
    """Home and enable the hub, run the excitation and record it, and disable the hub again.

    Parameters
    ----------
    rig : Rig -- as its nodes have it
    client : RigClient -- of the running rig
    has_images : bool -- there is a tracker, which is set to zero at home
    patience : float -- by what the limits on waiting are multiplied

    Raises
    ------
    RigUnavailableError
        A service refused, or what was waited for did not happen.
    """
    duration_s = recipe_of_rig(rig).total_s
    lead_s = first_lead(round(duration_s / rig.hub.period), rig.excitation.start_delay)
    longest_lead_s = longest_wait(lead_s)
    factor = rig.simulation.real_time_factor
    with Progress("home and enable", _ANSWER_TIMEOUT_S, "s") as stage:
        client.call("hub/home", timeout_s=_ANSWER_TIMEOUT_S * patience)
        if has_images:
            client.call("tracker/tare", timeout_s=_ANSWER_TIMEOUT_S * patience)
        client.call("hub/enable", value=True, timeout_s=_ANSWER_TIMEOUT_S * patience)
        client.wait(
            client.is_clock_settled,
            _CLOCK_TIMEOUT_S * patience,
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
        START_TIMEOUT_S * patience,
        "the recorder received nothing from hub and tracker",
        "look at bag_recorder.log",
    )
    with Progress(rig.excitation.kind, (lead_s + duration_s) / factor, "s") as stage:
        client.sequence = {}
        client.call("excitation/start", timeout_s=_ANSWER_TIMEOUT_S * patience + longest_lead_s / factor)
        client.wait(
            lambda: client.sequence.get("state") not in (None, "loading", "ready"),
            _ANSWER_TIMEOUT_S * patience + longest_lead_s / factor,
            "the sequence did not start",
            "hub/sequence_state says how far it came",
        )
        client.wait(
            lambda: client.sequence["state"] != "running",
            duration_s / factor + _ANSWER_TIMEOUT_S * patience,
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


def _live(client: RigClient) -> str:
    *_, tip = client.displacement.values()
    return f"hub {client.hub_position * 1e3:+7.3f} mm   tip marker {tip * 1e3:+7.2f} mm"


def node_ends(statuses: Mapping[str, int]) -> str:
    """Say how nodes ended, by their exit statuses."""
    failed = [f"{name} ended with status {status}" for name, status in statuses.items() if status]
    return ", ".join(failed) or f"{len(statuses)} node{'s' * (len(statuses) != 1)} ended with status 0"
