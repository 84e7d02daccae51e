"""Show the running rig, or a recorded bag, on a page in the browser.

Without a BAG the page shows the rig on your ROS domain as it runs, and has one control: stop, by button or by the
Escape key. With a BAG the same page plays it, from any place. The page is served to this computer alone; --host
serves it to others too, and then only by the link that is printed here, which opens it once.
"""

from __future__ import annotations

import argparse
import signal
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from beam_ros.cli.options import add_rig_file, read_rig
from beam_ros.process.executables import INTERRUPTED
from beam_ros.process.interruption import end_with, signals_taken
from beam_ros.rig.rig import Rig

if TYPE_CHECKING:
    from beam_ros.launching.live_view import LiveView
    from beam_ros.view.scene import Scene
    from beam_ros.view.server import PageServer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("bag", nargs="?", metavar="BAG", help="a recorded bag; without one: the running rig")
    add_rig_file(parser)
    parser.add_argument("--namespace", default=None, help="ROS namespace of the rig")
    parser.add_argument("--paused", action="store_true", help="let the bag stand still at first")
    add_page(parser)


def add_page(parser: argparse.ArgumentParser, port: int = 8350) -> None:
    """Declare where the page is served."""
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to serve the page at (default: this computer alone)"
    )
    parser.add_argument("--port", type=int, default=port, help=f"port (default: {port}); 0: any that is free")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    rig = read_rig(arguments)
    is_given = arguments.rig_file is not None or bool(arguments.parameters)
    return (_show_rig if arguments.bag is None else _show_bag)(arguments, rig, is_given)


def _show_bag(arguments: argparse.Namespace, rig: Rig, is_given: bool) -> int:
    from beam_ros.bags.reading import Bag
    from beam_ros.bags.summary import summarise
    from beam_ros.offline.recorded_estimates import RecordedEstimates
    from beam_ros.view.losses import losses_of_bag
    from beam_ros.view.recorded import RecordedScene
    from beam_ros.view.scene import Scene
    from beam_ros.view.server import PageServer

    with Bag(arguments.bag, namespace=arguments.namespace) as bag:
        info = summarise(bag)
    scene = Scene(rig, source="bag", title=str(info.path), is_rig_given=is_given)
    scene.show_losses(losses_of_bag(info))
    estimates = RecordedEstimates(arguments.bag, rig.live, arguments.namespace)
    player = RecordedScene(arguments.bag, scene, estimate_at=estimates.at)
    server = PageServer(
        scene,
        player.orders,
        on_tick=player.show,
        on_link=print_link,
        host=arguments.host,
        port=arguments.port,
    )
    player.start(is_paused=arguments.paused)
    return _until_interrupted(lambda: None, server.close, player.close, estimates.close)


def _show_rig(arguments: argparse.Namespace, rig: Rig, is_given: bool) -> int:
    with signals_taken(end_with(INTERRUPTED)):
        from beam_ros.launching.live_view import LiveView
        from beam_ros.shell.other_hubs import reach
        from beam_ros.view.scene import Scene

    scene = Scene(rig, source="rig", title=reach(), is_rig_given=is_given)
    with LiveView(scene, namespace=arguments.namespace or "") as view:
        server = serve_rig(scene, view, arguments.host, arguments.port)
        return _until_interrupted(view.look, server.close)


def serve_rig(
    scene: Scene, view: LiveView, host: str, port: int, on_link: Callable[[str], None] | None = None
) -> PageServer:
    """Serve the page of a running rig.

    Parameters
    ----------
    scene : Scene
    view : LiveView
    host : str
    port : int
    on_link : callable, optional -- takes the address that opens the page; by default it is printed
    """
    from beam_ros.view.server import PageServer

    server = PageServer(
        scene,
        {"stop": view.stop},
        on_tick=lambda: None,
        on_link=on_link or print_link,
        host=host,
        port=port,
    )
    view.wants_images = lambda: server.has_readers
    return server


def print_link(link: str) -> None:
    """Say where the page is."""
    print(f"page: {link}", flush=True)


def _until_interrupted(
    on_tick: Callable[[], None], *closings: Callable[[], None], period_s: float = 0.5
) -> int:
    print("Ctrl-C ends it", flush=True)
    try:
        while True:
            on_tick()
            time.sleep(period_s)
    except KeyboardInterrupt:
        return 0
    finally:
        with signals_taken(signal.SIG_IGN):
            for close in closings:
                close()
