"""Faults on request, for the nodes that stand in for an axis: a schedule at the start, and a live parameter."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from beam_ros.hub.emulated.injected_faults import (
    KINDS,
    FaultSchedule,
    InjectedFault,
    disturb,
    read_schedule,
    read_schedule_file,
)
from beam_ros.hub.errors import HubParameterError
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.shell.node import RigNode


class FaultyAxis(Protocol):
    """An axis that goes wrong when it is asked to."""

    @property
    def elapsed(self) -> float:
        """Time since the start [s], from which the times of faults count."""

    def check_faults(self, faults: Sequence[InjectedFault]) -> None:
        """Raise ``HubParameterError`` where these faults cannot happen here."""

    def bring_about(self, faults: Sequence[InjectedFault]) -> None:
        """Let faults happen that were checked."""


class FaultRequests:
    """Hands an axis the faults of ``faults.schedule``, and those that ``faults.request`` is set to.

    Parameters
    ----------
    node : RigNode
    axis : FaultyAxis

    Raises
    ------
    HubParameterError
        The schedule cannot be read, or asks for what cannot happen here.
    """

    def __init__(self, node: RigNode, axis: FaultyAxis) -> None:
        self._axis = axis
        schedule = read_schedule_file(node.rig.faults.schedule)
        axis.check_faults(schedule)
        axis.bring_about(schedule)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._take)

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            for text in _requests(parameters):
                self._axis.check_faults(read_schedule(text, "faults.request"))
        except HubParameterError as err:
            return SetParametersResult(successful=False, reason=str(err))
        return SetParametersResult(successful=True)

    def _take(self, parameters: list[Parameter]) -> None:
        for text in _requests(parameters):
            self._axis.bring_about(read_schedule(text, "faults.request", self._axis.elapsed))


class SimulatedAxisFaults:
    """What can go wrong with an axis in this process: the encoder lies, the hub sticks.

    Parameters
    ----------
    axis : VirtualAxis
    """

    def __init__(self, axis: VirtualAxis) -> None:
        self._axis = axis
        self._schedule = FaultSchedule()
        self._start_s = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Time since the start [s]."""
        return time.monotonic() - self._start_s

    def check_faults(self, faults: Sequence[InjectedFault]) -> None:
        """Refuse what needs a line, a clock or a device of its own."""
        possible = [name for name, kind in KINDS.items() if kind.place == "axis"]
        for fault in faults:
            if fault.kind not in possible:
                raise HubParameterError(
                    f"faults on request: the simulated hub has no line and no device for {fault.kind}; expected one "
                    f"of {', '.join(possible)}; use the emulated rig"
                )

    def bring_about(self, faults: Sequence[InjectedFault]) -> None:
        """Let faults happen, their times counted from the start."""
        self._schedule.add(faults)

    def happen(self) -> list[str]:
        """Do what is due, and return it for the log."""
        for fault, begins in self._schedule.changes(self.elapsed):
            disturb(self._axis, fault, begins=begins)
        return self._schedule.take_notes()


def _requests(parameters: list[Parameter]) -> list[str]:
    return [str(parameter.value) for parameter in parameters if parameter.name == "faults.request"]
