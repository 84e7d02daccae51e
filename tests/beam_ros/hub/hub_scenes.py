"""Hubs, moves and host clocks that the tests of this room share."""

from __future__ import annotations

import numpy as np

from beam_ros.hub import (
    HostTime,
    HubParameters,
    HubReport,
    RigidPlant,
    SequenceChunk,
    SimulatedHub,
    VirtualAxis,
)

UNIX_START = 1_700_000_000_000_000_000
STEADY_START = 5_000_000_000


def rest_to_rest(n_ticks: int, amplitude: float = 0.5) -> np.ndarray:
    """Accelerations of a move that ends at rest (second differences of a position that does)."""
    s = np.arange(n_ticks + 2) / (n_ticks + 1)
    a = np.diff(np.sin(np.pi * s) ** 4 * np.sin(4 * np.pi * s), n=2)
    return a * (amplitude / np.max(np.abs(a)))


def chunks_of(
    values: np.ndarray,
    start_ns: int,
    sequence_id: str = "move",
    size: int = 500,
    period_ns: int = 1_000_000,
) -> list[SequenceChunk]:
    count = -(-len(values) // size)
    return [
        SequenceChunk(
            sequence_id, k + 1, count, start_ns, period_ns, k * size, values[k * size : (k + 1) * size]
        )
        for k in range(count)
    ]


def enabled_axis(parameters: HubParameters, plant: object = None, **options: int) -> VirtualAxis:
    axis = VirtualAxis(parameters, plant or RigidPlant(0.8, parameters.period), **options)
    axis.request(1, "home")
    while axis.state != "homed":
        axis.feed()
        axis.advance(axis.device_ns + 10_000_000)
    axis.request(2, "enable")
    axis.take_completed()
    axis.take_events()
    assert axis.state == "enabled"
    return axis


class SimulatedRig:
    """A simulated hub with a host clock that the test moves."""

    def __init__(self, parameters: HubParameters, plant: object = None, **options: object) -> None:
        load = plant or RigidPlant(0.8, parameters.period)
        self.hub = SimulatedHub(VirtualAxis(parameters, load), **options)
        self.steady_ns = STEADY_START
        self.reports: list[HubReport] = []
        self.hub.poll(self.now)

    @property
    def now(self) -> HostTime:
        return HostTime(self.steady_ns, self.steady_ns - STEADY_START + UNIX_START)

    def run(self, seconds: float, step_ns: int = 10_000_000) -> list[HubReport]:
        end = self.steady_ns + round(seconds * 1e9)
        new = []
        while self.steady_ns < end:
            self.steady_ns += min(step_ns, end - self.steady_ns)
            new.append(self.hub.poll(self.now))
        self.reports += new
        return new

    def enable(self) -> None:
        for kind in ("home", "enable"):
            request_id = self.hub.request(kind)
            for _ in range(500):
                completed = dict(self.run(0.01)[-1].completed)
                if request_id in completed:
                    assert completed[request_id].success, completed
                    break
            else:
                raise AssertionError(f"{kind} did not end")
