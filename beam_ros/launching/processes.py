"""Nodes as child processes that never outlive the command that started them.

Each node is a process of its own session, so that a Ctrl-C in the terminal reaches the command alone, which
then ends its nodes in order: SIGINT, and only for one that does not listen SIGTERM and SIGKILL. On Linux the
kernel ends the nodes when the command itself is killed.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from beam_ros.environment import child_environment
from beam_ros.errors import RigUnavailableError
from beam_ros.executables import command
from beam_ros.interfaces import NODES
from beam_ros.rig import Rig

_C_LIBRARY = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
_GRACE_S = 5.0
_ONE_THREAD_EACH = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""A node's matrices are small: more threads only take the processor from its neighbours."""


def private_domain_environment(domain: int, log_folder: Path) -> dict[str, str]:
    """Environment that keeps a graph on this machine and on a domain of its own.

    Parameters
    ----------
    domain : int -- ROS_DOMAIN_ID, 1 to 101
    log_folder : Path -- where the nodes' logs go

    Returns
    -------
    dict -- variables to add to a process's environment
    """
    return {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "ROS_LOG_DIR": str(log_folder),
    }


class PrivateDomain:
    """A ROS domain that no other command of this suite uses at the same time on this machine.

    The claim is a locked file, which the kernel releases however the process ends.

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
            path = folder / f"beam-rig-domain-{self.number}.lock"
            try:
                self._file = path.open("w")
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            return
        raise RigUnavailableError(
            "no free ROS domain from 1 to 101 on this machine: expected one that no other demo holds; end "
            "another demo or test run first"
        )

    def release(self) -> None:
        """Give the domain back."""
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
    tuple of str -- where simulated time does not run in real time, everybody but the simulator follows `/clock`
    """
    words = ["--ros-args", "--params-file", str(rig_file)]
    if namespace:
        words += ["-r", f"__ns:=/{namespace.strip('/')}"]
    if executable != "simulator" and rig.number("simulation.real_time_factor") != 1.0:
        words += ["-p", "use_sim_time:=true"]
    return tuple(words)


@contextlib.contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Within this block SIGTERM interrupts as Ctrl-C does, so that both end the nodes in order."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Within this block, which takes seconds at most, SIGINT and SIGTERM are ignored."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    previous = [signal.signal(number, signal.SIG_IGN) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, previous, strict=True):
            signal.signal(number, handler)


def _prepare_child() -> None:
    """In the child before exec: end with the parent, and hold signals back until Python can take them."""
    _C_LIBRARY.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})


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
    environment : mapping -- variables added to the children's environment
    log_folder : Path -- one log file a node
    """

    environment: Mapping[str, str]
    log_folder: Path
    nodes: list[NodeProcess] = field(default_factory=list)

    def start(self, executable: str, arguments: Sequence[str] = ()) -> NodeProcess:
        """Start one node.

        Parameters
        ----------
        executable : str -- key of NODES
        arguments : sequence of str -- after the executable's name, `--ros-args` included
        """
        if executable not in NODES:
            raise RigUnavailableError(
                f"unknown node {executable!r}: expected one of {', '.join(sorted(NODES))}; `beam run --help` "
                "explains them"
            )
        self.log_folder.mkdir(parents=True, exist_ok=True)
        log = self.log_folder / f"{executable}.log"
        with log.open("wb") as stream:
            process = subprocess.Popen(
                [*command(executable), *arguments],
                env=child_environment({**_ONE_THREAD_EACH, **self.environment}),
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
        RigUnavailableError
            Names the node, its exit status and its last words.
        """
        node = self.fallen()
        if node is not None:
            raise RigUnavailableError(
                f"node {node.executable} ended with status {node.process.returncode}: {node.last_words()} "
                f"(whole log: {node.log})"
            )

    def end(self) -> dict[str, int]:
        """End every node, the last started first, and return their exit statuses."""
        with uninterrupted():
            return self._end()

    def _end(self) -> dict[str, int]:
        for number, patience_s in (
            (signal.SIGINT, _GRACE_S),
            (signal.SIGTERM, _GRACE_S),
            (signal.SIGKILL, 2.0),
        ):
            running = [node for node in reversed(self.nodes) if node.process.poll() is None]
            for node in running:
                node.process.send_signal(number)
            end = time.monotonic() + patience_s
            for node in running:
                try:
                    node.process.wait(max(0.0, end - time.monotonic()))
                except subprocess.TimeoutExpired:
                    continue
        return {node.executable: int(node.process.returncode or 0) for node in self.nodes}

    def __enter__(self) -> NodeGroup:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.end()
