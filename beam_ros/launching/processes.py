"""Nodes as child processes that never outlive the command that started them.

Each node is a process of its own session, so that a Ctrl-C in the terminal reaches the command alone, which
then ends its nodes in order: SIGINT, and only for one that does not listen SIGTERM and SIGKILL. On Linux the
kernel ends the nodes when the command itself is killed.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from beam_ros.errors import NodeFallenError, RigUnavailableError, suggestion
from beam_ros.interfaces.graph import NODES
from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command
from beam_ros.process.interruption import hold_signals_back, signals_taken
from beam_ros.process.processor_load import ProcessorLoad, processor_load
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import follows_clock

_C_LIBRARY = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
_GRACE_S = 10.0
"""A node that ends at once on an idle computer takes seconds on a busy one [s]."""
_ONE_THREAD_EACH = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""A node's matrices are small: more threads only take the processor from its neighbours."""


DISCOVERY_VARIABLES = (
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "ROS_SUPER_CLIENT",
    "ROS_LOCALHOST_ONLY",
    "ROS_SECURITY_ENABLE",
    "ROS_SECURITY_STRATEGY",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
    "RMW_FASTRTPS_USE_QOS_FROM_XML",
    "RMW_IMPLEMENTATION",
)
"""What in a shell could lead a private graph off this machine or keep it from finding itself."""


def stay_on_this_machine(environ: MutableMapping[str, str], domain: int, log_folder: Path) -> None:
    """Change an environment so that its processes' graph stays on this machine, on a domain of its own.

    Parameters
    ----------
    environ : mutable mapping -- usually ``os.environ``, from which child processes inherit
    domain : int -- ROS_DOMAIN_ID, 1 to 101
    log_folder : Path -- where the nodes' logs go
    """
    for name in DISCOVERY_VARIABLES:
        environ.pop(name, None)
    environ["ROS_DOMAIN_ID"] = str(domain)
    environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    environ["ROS_LOG_DIR"] = str(log_folder)


class PrivateDomain:
    """A ROS domain that no other command of this suite uses at the same time on this machine.

    The claim is a locked file, which the kernel releases however the process ends; ``release`` also takes it away.

    Raises
    ------
    RigUnavailableError
        All domains are taken.
    """

    def __init__(self) -> None:
        folder = Path(tempfile.gettempdir())
        first = os.getpid() % 101
        for step in range(101):
            self.number = (first + step) % 101 + 1
            self._path = folder / f"beam-rig-domain-{self.number}.lock"
            try:
                self._file = self._path.open("w")
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(self._file.fileno()).st_ino != self._path.stat().st_ino:
                    continue  # Taken away by its last owner between these lines; somebody else may have a new one.
            except OSError:
                continue
            return
        raise RigUnavailableError(
            "no free ROS domain from 1 to 101 on this machine: expected one that no other demo holds; end "
            "another demo or test run first"
        )

    def release(self) -> None:
        """Give the domain back."""
        self._path.unlink(missing_ok=True)
        self._file.close()


def node_arguments(executable: str, rig: Rig, rig_file: Path, namespace: str = "") -> tuple[str, ...]:
    """ROS arguments that start a node on a rig file.

    Parameters
    ----------
    executable : str -- key of NODES
    rig : Rig -- what the file holds
    rig_file : Path
    namespace : str -- of all nodes of this rig; empty: the root

    Returns
    -------
    tuple of str -- where simulated time does not run in real time, everybody but the simulator follows ``/clock``
    """
    words = ["--ros-args", "--params-file", str(rig_file)]
    if namespace:
        words += ["-r", f"__ns:=/{namespace.strip('/')}"]
    if follows_clock(executable, rig):
        words += ["-p", "use_sim_time:=true"]
    return tuple(words)


def _prepare_child() -> None:
    """In the child before exec: end with the parent, and hold signals back until Python can take them."""
    _C_LIBRARY.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    hold_signals_back()


@dataclass
class NodeProcess:
    """One running node.

    Attributes
    ----------
    executable : str -- key of NODES
    process : subprocess.Popen
    log : Path -- what the node printed
    """

    executable: str
    process: subprocess.Popen[bytes]
    log: Path

    def last_words(self, lines: int = 3) -> str:
        """Last lines that the node printed, for a message about its end."""
        text = self.log.read_text(errors="replace").strip().splitlines()
        return " | ".join(text[-lines:]) if text else "it printed nothing"


@dataclass
class NodeGroup:
    """The processes of a rig, started in order and ended in the opposite one.

    Parameters
    ----------
    log_folder : Path -- one log file a node
    """

    log_folder: Path
    nodes: list[NodeProcess] = field(default_factory=list)

    def start(self, executable: str, arguments: Sequence[str] = ()) -> NodeProcess:
        """Start one node.

        Parameters
        ----------
        executable : str -- key of NODES
        arguments : sequence of str -- after the executable's name, ``--ros-args`` included
        """
        if executable not in NODES:
            raise RigUnavailableError(
                f"unknown node {executable!r} ({suggestion(executable, NODES)}); `beam run --help` "
                "explains them"
            )
        self.log_folder.mkdir(parents=True, exist_ok=True)
        log = self.log_folder / f"{executable}.log"
        with log.open("wb") as stream:
            process = subprocess.Popen(
                [*command(executable), *arguments],
                env=child_environment(_ONE_THREAD_EACH),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=_prepare_child,
            )
        node = NodeProcess(executable, process, log)
        self.nodes.append(node)
        return node

    def fallen(self) -> NodeProcess | None:
        """First node that has ended by itself, or None while all run."""
        return next((node for node in self.nodes if node.process.poll() is not None), None)

    def check(self) -> None:
        """Raise where a node has ended by itself.

        Raises
        ------
        NodeFallenError
            Names the node, its exit status and its last words.
        """
        node = self.fallen()
        if node is not None:
            raise NodeFallenError(
                f"node {node.executable} ended with status {node.process.returncode}: {node.last_words()} "
                f"(whole log: {node.log})"
            )

    def end(self, *, but: Sequence[str] = ()) -> dict[str, int]:
        """End nodes, the last started first, and return their exit statuses; takes seconds at most.

        Parameters
        ----------
        but : sequence of str -- executables that go on
        """
        going_on = [node for node in self.nodes if node.executable in but]
        ending = [node for node in self.nodes if node.executable not in but]
        with signals_taken(signal.SIG_IGN):
            statuses = self._end(ending)
        # Whoever was ended is not missed.
        self.nodes = going_on
        return statuses

    @staticmethod
    def _end(nodes: Sequence[NodeProcess]) -> dict[str, int]:
        for number, patience_s in (
            (signal.SIGINT, _GRACE_S),
            (signal.SIGTERM, _GRACE_S),
            (signal.SIGKILL, 2.0),
        ):
            running = [node for node in reversed(nodes) if node.process.poll() is None]
            for node in running:
                node.process.send_signal(number)
            end = time.monotonic() + patience_s
            for node in running:
                try:
                    node.process.wait(max(0.0, end - time.monotonic()))
                except subprocess.TimeoutExpired:
                    continue
        return {node.executable: int(node.process.returncode or 0) for node in nodes}

    def load(self) -> ProcessorLoad:
        """Say how busy this computer is, and what these nodes get of it."""
        return processor_load(node.process.pid for node in self.nodes)

    def __enter__(self) -> NodeGroup:
        return self

    def __exit__(self, *raised: object) -> None:
        self.end()
