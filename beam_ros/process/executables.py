"""The executables: each makes the environment safe first and only then imports what it runs.

``pip`` and ``colcon`` make a script of each name in ``MODULES``; ``command`` gives the same as an argument list that
works under both. What is missing on the machine (ROS 2, a camera or a serial library) ends in one line and
status 2.
"""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Sequence
from functools import partial

from beam_ros.process import environment
from beam_ros.process.interruption import end_with, take_signals

MODULES = {
    "beam": "beam_ros.cli.main",
    "simulator": "beam_ros.nodes.simulator",
    "hub_driver": "beam_ros.nodes.hub_driver",
    "vision_tracker": "beam_ros.nodes.vision_tracker",
    "excitation_generator": "beam_ros.nodes.excitation_generator",
    "identifier": "beam_ros.nodes.identifier",
    "live_identifier": "beam_ros.nodes.live_identifier",
    "bag_recorder": "beam_ros.nodes.bag_recorder",
    "bag_player": "beam_ros.nodes.bag_player",
    "firmware_emulator": "beam_ros.nodes.firmware_emulator",
}
"""Executables and the modules whose ``main`` they run; all but ``beam`` are nodes."""

INTERRUPTED = 130
"""Exit status of a command that Ctrl-C ended; a node ends with 0."""

_PACKAGES = {  # module: (name on PyPI, name in Ubuntu)
    "cv2": ("opencv-python-headless", "python3-opencv"),
    "serial": ("pyserial", "python3-serial"),
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "numpy": ("numpy", "python3-numpy"),
    "scipy": ("scipy", "python3-scipy"),
    "tqdm": ("tqdm", "python3-tqdm"),
    "ruamel": ("ruamel.yaml", "python3-ruamel.yaml"),
    "rosbags": ("rosbags", None),
    "mcap": ("mcap", None),
    "aiohttp": ("aiohttp", "python3-aiohttp"),
}


def command(executable: str) -> list[str]:
    """Argument list that starts an executable of the suite with this process's own Python.

    Parameters
    ----------
    executable : str -- a key of MODULES

    Returns
    -------
    list of str -- to be followed by the executable's own arguments; goes with ``environment.child_environment``
    """
    safe_path = ["-P"] if sys.version_info >= (3, 11) else []
    return [sys.executable, *safe_path, "-m", __name__, executable]


def run_executable(name: str, arguments: Sequence[str] | None = None) -> int:
    """Run an executable in this process.

    Parameters
    ----------
    name : str -- a key of MODULES
    arguments : sequence of str, optional -- its arguments without its name; by default the process's own

    Returns
    -------
    int -- exit status; 2 with one line on stderr when a package it needs is missing
    """
    is_node = name != "beam"
    # Until the module has something to stop; then it says itself what a signal does.
    take_signals(end_with(0 if is_node else INTERRUPTED))
    try:
        environment.enter()
        if is_node:
            importlib.import_module("rclpy")
        module = importlib.import_module(MODULES[name])
        status: int = module.main(None if arguments is None else list(arguments))
    except ImportError as error:
        refusal = _refusal(error)
        if refusal is None:
            raise
        print(f"{name}: {refusal}", file=sys.stderr)  # noqa: T201 - no logger exists without rclpy
        return 2
    finally:
        take_signals(signal.SIG_IGN)  # The interpreter puts itself away, which takes a moment.
    return status


def _refusal(error: ImportError) -> str | None:
    """One line for a package that is missing on this machine; None for a fault of the suite's own."""
    module = (error.name or "").partition(".")[0]
    if module == "rclpy" or module.endswith(("_msgs", "_srvs", "_interfaces")):
        reason = str(error).partition("\n")[0]
        return (
            f"ROS 2 cannot be used by {sys.executable} ({reason}); expected rclpy 7.1 of ROS 2 Jazzy; run "
            "`make setup` in the source tree, or `source /opt/ros/jazzy/setup.bash` where it is installed"
        )
    if module not in _PACKAGES or not isinstance(error, ModuleNotFoundError):
        return None
    on_pypi, in_ubuntu = _PACKAGES[module]
    remedy = f"{sys.executable} -m pip install {on_pypi}"
    if sys.prefix == sys.base_prefix:
        remedy = f"sudo apt install {in_ubuntu}" if in_ubuntu else "python3 bootstrap.py"
    return f"{sys.executable} has no module {module!r}; expected the package {on_pypi}; run `{remedy}`"


for _name in MODULES:  # what the scripts of pip and colcon import
    globals()[_name] = partial(run_executable, _name)

if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in MODULES:
        print(  # noqa: T201
            f"beam_ros.process.executables: {' '.join(sys.argv[1:]) or 'nothing'} asked for; expected one of "
            f"{', '.join(MODULES)}",
            file=sys.stderr,
        )
        sys.exit(2)
    del sys.argv[0]
    sys.exit(run_executable(sys.argv[0]))
