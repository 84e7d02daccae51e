"""The suite's executables as real processes that never outlive the test that started them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from beam_ros.process.environment import child_environment
from beam_ros.process.executables import command

MARK = "BEAM_TEST_PROCESS"
"""Variable that marks a test's processes; its value is the test's own."""

_GRACE_S = 8.0


@dataclass
class RunningExecutable:
    """A started executable: its process and what it has printed so far (both streams).

    Attributes
    ----------
    name : str
    process : subprocess.Popen -- leader of its own process group
    log : Path -- where its output goes
    """

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    deadline: threading.Timer = field(repr=False)
    is_overdue: bool = False

    def output(self) -> str:
        """Everything printed so far."""
        return self.log.read_text(errors="replace")

    def wait_for(self, text: str, timeout_s: float = 60.0) -> str:
        """Wait until `text` has been printed; return the whole output."""
        end = time.monotonic() + timeout_s
        while text not in self.output():
            if self.process.poll() is not None:
                pytest.fail(
                    f"{self.name} ended ({self.process.returncode}) before {text!r}:\n{self.output()}"
                )
            if time.monotonic() > end:
                pytest.fail(f"{self.name} did not print {text!r} within {timeout_s:g} s:\n{self.output()}")
            time.sleep(0.02)
        return self.output()

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal to the executable alone."""
        self.process.send_signal(number)

    def wait(self, timeout_s: float = 60.0) -> int:
        """Wait for the end and return the exit status; fail the test when it does not come."""
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f"{self.name} still runs after {timeout_s:g} s:\n{self.output()}")


class Executables:
    """Starts the suite's executables as real processes and sees to it that none is left."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._mark = uuid.uuid4().hex
        self._running: list[RunningExecutable] = []

    def start(
        self,
        name: str,
        *arguments: str,
        environment: Mapping[str, str] | None = None,
        timeout_s: float = 180.0,
        program: Sequence[str] = (),
    ) -> RunningExecutable:
        """Start an executable in a process group of its own.

        Parameters
        ----------
        name : str -- `beam` or a node's executable
        *arguments : str -- its command line
        environment : mapping, optional -- variables on top of the session's private domain
        timeout_s : float -- hard limit; the process is killed and the test fails
        program : sequence of str -- what runs the executable in its own way; by default the suite's own
        """
        log = self._folder / f"{len(self._running)}-{name}.log"
        with log.open("wb") as stream:
            process = subprocess.Popen(
                [*(program or command(name)), *arguments],
                cwd=self._folder,
                env=child_environment({MARK: self._mark, **(environment or {})}),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        running = RunningExecutable(
            name, process, log, threading.Timer(timeout_s, lambda: self._end(running))
        )
        running.deadline.daemon = True
        running.deadline.start()
        self._running.append(running)
        return running

    def run(self, name: str, *arguments: str, timeout_s: float = 180.0) -> RunningExecutable:
        """Run an executable to its end."""
        running = self.start(name, *arguments, timeout_s=timeout_s + 5.0)
        running.wait(timeout_s)
        return running

    def interrupt(self) -> None:
        """Ask everything that still runs to end."""
        for running in reversed(self._running):
            if running.process.poll() is None:
                running.process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """End what still runs; fail the test for what had to be killed."""
        faults = []
        for running in reversed(self._running):
            running.deadline.cancel()
            if running.is_overdue:
                faults.append(f"{running.name} was killed at its time limit:\n{running.output()}")
        self.interrupt()
        for running in reversed(self._running):
            try:
                running.process.wait(_GRACE_S)
            except subprocess.TimeoutExpired:
                faults.append(f"{running.name} ignored SIGINT for {_GRACE_S:g} s:\n{running.output()}")
                running.process.kill()
                running.process.wait()
        # The helper that Python starts beside processes of its own ends a moment after them.
        end = time.monotonic() + _GRACE_S
        while marked_processes(self._mark) and time.monotonic() < end:
            time.sleep(0.05)
        for pid in marked_processes(self._mark):
            faults.append(f"process {pid} was left behind")
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        if faults:
            pytest.fail("\n".join(faults))

    @staticmethod
    def _end(running: RunningExecutable) -> None:
        if running.process.poll() is None:
            running.is_overdue = True
            running.process.kill()


def marked_processes(mark: str) -> list[int]:
    """Find every process that a test's processes have started, whatever group it belongs to.

    The mark is in the environment, which children inherit.
    """
    wanted = f"{MARK}={mark}".encode()
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if wanted in (entry / "environ").read_bytes().split(b"\0"):
                found.append(int(entry.name))
        except OSError:  # it has just ended, or is somebody else's
            continue
    return found
