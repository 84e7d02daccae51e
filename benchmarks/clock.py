"""How well the driver's stamps are placed, and whether the stated uncertainty is true.

    python -m benchmarks.clock [--seeds N] [--seconds S] [--json FILE]

A device's clock runs 60 ppm fast; the driver's own ``DeviceClock`` asks it over lines of several characters, in
virtual time. Every line has a fixed way out and a fixed way back, queueing on both, and now and then an outlier of
20 ms. From 10 s on, every batch's stamp is compared with the true instant.

`below 0.1 ms` is the share of stamps with a smaller error, `covered` the share within 1.96 of the stated standard
deviations, `without constant` the same where the constant of the round trip is left out, as if way out and way back
were alike.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from beam_ros.hub.contract import HostTime
from beam_ros.hub.host.sample_stamping import DeviceClock
from beam_ros.hub.host_clock import HostClock

DRIFT_PPM = 60.0
SETTLED_S = 10.0
BATCH_NS = 20_000_000
STEP_NS = 10_000_000
HOST_START = 8_000_000_000_000
DEVICE_START = 123_456_789_000


@dataclass(frozen=True)
class Line:
    """A way to a device and back.

    Parameters
    ----------
    out_ns, back_ns : float
        What every frame needs at least [ns].
    queue_ns : float
        Mean of what queueing adds on either way [ns].
    outliers : float
        Share of frames that are 20 ms late, on either way.
    """

    out_ns: float
    back_ns: float
    queue_ns: float
    outliers: float = 0.03

    def ways_ns(self, rng: np.random.Generator) -> tuple[int, int]:
        """Draw a way out and a way back [ns]."""
        ways = np.array([self.out_ns, self.back_ns]) + rng.exponential(self.queue_ns, 2)
        late = rng.random(2) < self.outliers
        out, back = (ways + late * rng.exponential(20e6, 2)).tolist()
        return round(out), round(back)


LINES = {
    "even": Line(60e3, 60e3, 40e3),
    "longer back": Line(60e3, 230e3, 40e3),
    "longer out": Line(230e3, 60e3, 40e3),
    "UART, 921 600 baud": Line(110e3, 295e3, 15e3),
    "busy host": Line(60e3, 60e3, 400e3, outliers=0.1),
}
"""A question has 10 bytes and an answer 27: that is 0.11 ms and 0.29 ms at 921 600 baud."""


@dataclass(frozen=True)
class Accuracy:
    """What came out of one line.

    Parameters
    ----------
    median_us, worst_us : float
        Of the stamps' errors; of their magnitudes [us].
    stated_us : float
        Median of the stated standard deviations [us].
    below : float
        Share of errors below 0.1 ms.
    covered : float
        Share within 1.96 stated standard deviations.
    covered_without : float
        The same without the constant that the round trip leaves open.
    """

    median_us: float
    worst_us: float
    stated_us: float
    below: float
    covered: float
    covered_without: float


def stamp_errors(line: Line, seed: int, seconds: float) -> np.ndarray:
    """Return error, stated deviation, and that without the constant [ns], shape (n_batches, 3)."""
    rng = np.random.default_rng(seed)
    rate = 1 + DRIFT_PPM * 1e-6
    device = DeviceClock(50_000, lambda name, reason: print(name, reason))
    device.connect(HOST_START, is_new_boot=True)
    clock = HostClock(HostTime(HOST_START, HOST_START))
    rows = []
    waiting: list[tuple[int, int, int]] = []
    for k in range(round(seconds * 1e9) // STEP_NS):
        now = HOST_START + k * STEP_NS
        for received, number, came in [late for late in waiting if late[0] <= now]:
            device.answer(number, came, came, received, clock)
        waiting = [late for late in waiting if late[0] > now]
        number = device.query(now)
        if number is not None:
            out, back = line.ways_ns(rng)
            waiting.append((now + out + back, number, DEVICE_START + round((now + out - HOST_START) * rate)))
        if now % BATCH_NS or now - HOST_START < SETTLED_S * 1e9:
            continue
        shown = DEVICE_START + round((now - HOST_START) * rate)
        mapping = device.mapping
        sd = mapping.stamp_sd_ns(shown)
        rows.append((mapping.host_ns(shown) - now, sd, mapping.standard_deviation_ns(shown)))
    return np.array(rows)


def study(line: Line, n_seeds: int, seconds: float) -> Accuracy:
    """Return what stamps are worth on a line, over several seeds."""
    rows = np.concatenate([stamp_errors(line, seed, seconds) for seed in range(n_seeds)])
    errors, stated, without = np.abs(rows[:, 0]), rows[:, 1], rows[:, 2]
    return Accuracy(
        float(np.median(rows[:, 0])) / 1e3,
        float(np.max(errors)) / 1e3,
        float(np.median(stated)) / 1e3,
        float(np.mean(errors < 100e3)),
        float(np.mean(errors <= 1.96 * stated)),
        float(np.mean(errors <= 1.96 * without)),
    )


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = {name: study(line, arguments.seeds, arguments.seconds) for name, line in LINES.items()}
    print(
        f"{'line':22}{'median':>9}{'worst':>9}{'stated':>9}{'below 0.1 ms':>14}{'covered':>9}{'without':>9}"
    )
    for name, row in found.items():
        print(
            f"{name:22}{row.median_us:7.1f}us{row.worst_us:7.1f}us{row.stated_us:7.1f}us{row.below:14.2%}"
            f"{row.covered:9.2%}{row.covered_without:9.2%}"
        )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps({name: asdict(row) for name, row in found.items()}, indent=1))


if __name__ == "__main__":
    main()
