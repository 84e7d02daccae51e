"""Start the rig's nodes together and keep them until Ctrl-C.

The nodes' logs go to runs/<time>-up-<rig>/logs. They use your own ROS domain and discovery range, so that
viewers, `ros2` and other nodes can attach. What the rig does is shown below: in a terminal by lines that change in
place, and as a line for each change where output is kept. `--view` shows it on a page in the browser too, whose one
control is stop. Where somebody watches, an estimate grows while the rig runs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from beam_ros.cli.live.view import add_page, serve_rig
from beam_ros.cli.options import add_rig_file, read_rig, run_folder
from beam_ros.interfaces.graph import RigKind, emulated_port, nodes_of_rig
from beam_ros.launching.guards import refuse_what_cannot_run
from beam_ros.launching.processes import (
    NodeGroup,
    node_arguments,
)
from beam_ros.process.executables import INTERRUPTED
from beam_ros.process.folders import make_folder
from beam_ros.process.interruption import end_with, signals_taken
from beam_ros.rig.rig import Rig

if TYPE_CHECKING:
    from beam_ros.launching.live_view import LiveView
    from beam_ros.view.scene import Scene
    from beam_ros.view.terminal import ChangingLines

_WATCH_S = 0.2
_START_TIMEOUT_S = 40.0
_CONNECT_S = 5.0
"""A real axis that is there is connected by then [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    kinds = [kind.value for kind in RigKind]
    parser.add_argument("--rig", choices=kinds, required=True, help="what stands behind the topics")
    add_rig_file(parser)
    parser.add_argument("--namespace", default="", help="ROS namespace for every node of this rig")
    parser.add_argument("--record", type=Path, metavar="BAG", help="also record to this folder")
    parser.add_argument("--view", action="store_true", help="also show all on a page, in the browser")
    add_page(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    rig, kind = read_rig(arguments), RigKind(arguments.rig)
    refuse_what_cannot_run(kind, rig, arguments.record)
    has_images = kind is not RigKind.SIMULATED or rig.simulation.images
    executables = list(nodes_of_rig(kind, with_camera_images=has_images))
    is_seen = arguments.view or sys.stdout.isatty()
    if is_seen:
        executables.append("live_identifier")
    changes: dict[str, object] = {}
    if arguments.record is not None:
        executables.append("bag_recorder")
        changes["recorder.path"] = str(arguments.record.resolve())
    with signals_taken(end_with(INTERRUPTED)):
        from beam_ros.launching.client import RigClient
        from beam_ros.shell.other_hubs import reach

    with (
        tempfile.TemporaryDirectory(prefix="beam-rig-") as scratch,
        RigClient(namespace=arguments.namespace) as client,
        ExitStack() as shown,
    ):
        client.refuse_live_hub()
        watch = _Watch(arguments, rig, shown, is_seen)
        logs = make_folder(run_folder(None, f"up-{kind.value}")) / "logs"
        if kind is RigKind.EMULATED:
            changes.update(emulated_port(rig.serial.port or f"{scratch}/controller"))
        rig_file = logs.parent / "rig.yaml"
        rig.with_values(changes).write(rig_file)
        with NodeGroup(logs) as nodes:
            client.check = nodes.check
            for executable in executables:
                nodes.start(executable, node_arguments(executable, rig, rig_file, arguments.namespace))
            # A real axis may be plugged in later: the rig stays up, and says what it waits for.
            patience_ends = time.monotonic() + rig.serial.patience + _CONNECT_S
            is_heard = client.is_recording if arguments.record else client.is_hub_heard
            client.wait(
                lambda: (
                    is_heard()
                    or (
                        kind is RigKind.REAL and bool(client.hub_trouble) and time.monotonic() > patience_ends
                    )
                ),
                _START_TIMEOUT_S + rig.serial.patience,
                f"the hub published no {'samples that were recorded' if arguments.record else 'state'}",
                f"look at the nodes' logs in {logs}",
            )
            print(f"{kind.value} rig up: {', '.join(executables)}; logs in {logs}")
            if client.hub_trouble:
                print(f"hub {client.hub_trouble}")
            print(f"{reach()}; Ctrl-C ends it", flush=True)
            try:
                while True:
                    nodes.check()
                    watch.show()
                    time.sleep(_WATCH_S)
            except KeyboardInterrupt:
                statuses = nodes.end()
    failed = [f"{name} with status {status}" for name, status in statuses.items() if status]
    print("ended" if not failed else f"ended, but {', '.join(failed)}; logs in {logs}")
    return 1 if failed else 0


class _Watch:
    """Shows what the rig does: in the terminal, and on the page where it was asked for."""

    def __init__(self, arguments: argparse.Namespace, rig: Rig, shown: ExitStack, is_seen: bool) -> None:
        from beam_ros.launching.live_view import LIGHT_TOPICS, TEXT_TOPICS, LiveView
        from beam_ros.shell.other_hubs import reach
        from beam_ros.view.scene import Cursor, Scene
        from beam_ros.view.terminal import ChangingLines

        self._lines: ChangingLines = ChangingLines(sys.stdout)
        self._scene: Scene = Scene(rig, source="rig", title=reach(), is_rig_given=True)
        self._view: LiveView = shown.enter_context(
            LiveView(
                self._scene,
                namespace=arguments.namespace,
                topics=LIGHT_TOPICS if is_seen else TEXT_TOPICS,
            )
        )
        self._cursor = Cursor()
        if arguments.view:
            server = serve_rig(
                self._scene,
                self._view,
                arguments.host,
                arguments.port,
                on_link=lambda link: self._lines.say(f"page: {link}"),
            )
            shown.callback(server.close)

    def show(self) -> None:
        """Print what is new, and what is now."""
        from beam_ros.view.terminal import log_line, status_lines

        self._view.look()
        for entry in self._scene.new_entries(self._cursor):
            self._lines.say(log_line(entry))
        if self._lines.is_watched:
            self._lines.show(status_lines(self._scene))
