"""What ``beam up`` and the launch files refuse before any node is started."""

from __future__ import annotations

from pathlib import Path

from beam_ros.errors import UsageError
from beam_ros.interfaces.graph import RigKind
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import check_time_of_rig


def refuse_what_cannot_run(kind: RigKind, rig: Rig, bag: Path | None = None) -> None:
    """Raise where a rig cannot be started as it is asked for.

    Parameters
    ----------
    kind : RigKind
    rig : Rig
    bag : Path, optional -- where it is to be recorded

    Raises
    ------
    UsageError
        Something is at the bag's path, a real rig has no port, or a node cannot keep the time that it is given.
    """
    refuse_existing(bag)
    check_time_of_rig(kind, rig)
    if kind is RigKind.REAL and rig.lacks_port:
        raise UsageError(
            "--rig real needs the controller's port: expected serial.port in the rig file, or "
            "-p serial.port:=/dev/ttyACM0"
        )


def refuse_existing(bag: Path | None) -> None:
    """Raise where something is at the path of a new bag.

    Raises
    ------
    UsageError
    """
    if bag is not None and bag.exists():
        raise UsageError(f"--record {bag}: exists already; give a folder that does not")


def refuse_live_hub(namespace: str = "") -> None:
    """Look round on the graph, which takes seconds, and raise where a hub is there, or a replay of one.

    Raises
    ------
    RigUnavailableError
    """
    from beam_ros.launching.client import RigClient

    with RigClient(namespace=namespace) as client:
        client.refuse_live_hub()
