"""What a board's lines say, in virtual time: the board's clock against the times at which its lines came."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.emulated.line_board import COUNT, LineBoard
from beam_ros.hub.link_parameters import CsvColumns
from beam_ros.hub.links.csv_measurements import CsvMeasurements
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant

# The counter of microseconds wraps within the first second.
DEVICE = SimulatedDevice(clock_drift_ppm=200.0, clock_start_ns=((1 << 32) - 1_000_000) * 1000)
STEADY_NS, SHORTEST_NS = 7_000_000_000, 300_000


def _measured(columns: CsvColumns, mean_lateness_ns: float) -> tuple[np.ndarray, ...]:
    """Return times [ns] and positions of three seconds, and where the hub truly was then [m]."""
    board = LineBoard(AxisParameters(), RigidPlant(0.8, 1e-3), DEVICE)
    faults: list[str] = []
    lines = CsvMeasurements(columns, lambda name, _: faults.append(name))
    rng, came_ns, rows = np.random.default_rng(5), 0, []
    for elapsed_ns in range(0, 3_000_000_000, 1_000_000):
        data = board.exchange(b"", DEVICE.clock_start_ns + round(elapsed_ns * 1.0002))
        came_ns = max(came_ns, elapsed_ns + SHORTEST_NS + round(rng.exponential(mean_lateness_ns)))
        rows += [row for row in lines.feed(data, STEADY_NS + came_ns) if row.steady_ns is not None]
    assert not faults
    # The newest times may lie ahead of what the board has done.
    stamps = np.array([row.steady_ns for row in rows])[-400:-20]
    device_ns = DEVICE.clock_start_ns + np.round((stamps - STEADY_NS) * 1.0002).astype(np.int64)
    positions = np.array([row.position for row in rows])[-400:-20]
    return stamps, positions, board.axis.snapshots(device_ns).positions


@pytest.mark.parametrize("mean_lateness_ns", [0.0, 3e5, 1e6])
def test_stamps_are_those_of_the_boards_clock_but_for_the_shortest_delay(mean_lateness_ns: float) -> None:
    stamps, positions, truth = _measured(
        CsvColumns(position=2, clock=1, position_scale=COUNT), mean_lateness_ns
    )
    error, velocity = positions - truth, np.gradient(truth, stamps * 1e-9)
    delay = -float(velocity @ error) / float(velocity @ velocity)
    # A line waits for its board's next turn as well, up to 1 ms; of twenty in a row the least delayed counts.
    assert SHORTEST_NS < delay * 1e9 < SHORTEST_NS + 1e6 + mean_lateness_ns / 5
    # Half a count is left, and what the least of twenty delays still scatters.
    assert np.std(error + delay * velocity) < 1e-6 + mean_lateness_ns * 1e-9 / 20 * np.std(velocity)
    assert np.median(np.diff(stamps)) == pytest.approx(5e6 / 1.0002, rel=1e-3)


def test_without_a_clock_every_lines_lateness_is_in_its_stamp() -> None:
    _, positions, truth = _measured(CsvColumns(position=2, position_scale=COUNT), 1e6)
    assert 3e-6 < np.std(positions - truth) < 1e-4
