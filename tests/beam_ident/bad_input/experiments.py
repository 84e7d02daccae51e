"""Sound experiments with a known truth, small enough for hundreds of runs, as the raw arrays that a fault spoils."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident import InputSignal, LogChirp, ModalModel, OutputSignal, TimeRecord, TransferFunctionModel

PERIOD_S = 0.01
OMEGA, ZETA = 20.0, 0.05
GAINS = {"y": 1.0, "z": -0.5}  # static, of the two outputs
NOISE = 0.01  # of every output, by its standard deviation
LINE_PERIOD_S = 2.56
_DRAW = 100  # between the seeds of one draw of the noise and the next
STEPS = (np.array([2.5, 3.6]), np.array([5.0, 12.0]), np.array([7.0, 13.9]))  # Hz, from, to
PLANT = TransferFunctionModel(
    np.array([OMEGA**2]), np.array([1.0, 2.0 * ZETA * OMEGA, OMEGA**2]), 0.0, np.zeros((4, 4)), 0.0
)


@dataclass(frozen=True)
class Raw:
    """What a laboratory hands over, before any check: a fault may make anything of it.

    Attributes
    ----------
    drive, drive_times : the input's values and stamps [s]
    seen, stamps : values and stamps [s] of every output
    hold, sigma, exposure_s : what is declared
    reference : a second input of the closed loop, or None
    """

    drive: Any
    drive_times: Any
    seen: Mapping[str, Any]
    stamps: Mapping[str, Any]
    hold: Any = "zoh"
    sigma: Any = 0.0
    exposure_s: Any = 0.0
    reference: Any = None

    def record(self) -> TimeRecord:
        """Return the record, or raise what its constructors raise."""
        inputs = [InputSignal("u", "", self.drive_times, self.drive, self.hold, self.sigma)]
        if self.reference is not None:
            inputs.append(InputSignal("r", "", self.drive_times, self.reference, "zoh"))
        outputs = [
            OutputSignal(name, "", self.stamps[name], values, self.exposure_s)
            for name, values in self.seen.items()
        ]
        return TimeRecord(tuple(inputs), tuple(outputs))


def outputs_of(drive: InputSignal, stamps: np.ndarray, seed: int, order: int = 0) -> dict[str, np.ndarray]:
    """Return both noisy outputs of the plant to a held input, differentiated so often."""
    rng = np.random.default_rng(seed)
    model = PLANT
    if order:
        model = TransferFunctionModel(
            np.array([OMEGA ** (2 - order)] + [0.0] * order),
            PLANT.denominator,
            0.0,
            np.zeros((4 + order,) * 2),
            0.0,
        )
    clean = model.simulate(drive, stamps)
    return {name: gain * clean + NOISE * rng.standard_normal(len(stamps)) for name, gain in GAINS.items()}


def _raw(drive: InputSignal, stamps: np.ndarray, seen: dict[str, np.ndarray], **declared: Any) -> Raw:
    return Raw(
        np.array(drive.values),
        np.array(drive.times_s),
        seen,
        dict.fromkeys(seen, stamps),
        drive.hold,
        **declared,
    )


@functools.cache
def shaken(draw: int = 0, order: int = 0) -> Raw:
    """Return the plant under three periods of a held noise up to a quarter of the rate."""
    rng = np.random.default_rng(11)
    period = np.convolve(rng.standard_normal(256), np.ones(3), mode="same")
    drive = InputSignal("u", "", (0.0, PERIOD_S), np.tile(period, 4), "zoh")
    stamps = PERIOD_S * np.arange(1, 1024)
    return _raw(drive, stamps, outputs_of(drive, stamps, 12 + _DRAW * draw, order))


@functools.cache
def shaken_long(draw: int = 0) -> Raw:
    """Return the plant under noise that does not repeat, long enough for lines closer than its resonance is wide."""
    rng = np.random.default_rng(21)
    values = np.convolve(rng.standard_normal(8192), np.ones(3), mode="same")
    drive = InputSignal("u", "", (0.0, PERIOD_S), values, "linear")
    stamps = PERIOD_S * np.arange(1, 8192)
    return _raw(drive, stamps, outputs_of(drive, stamps, 22 + _DRAW * draw))


@functools.cache
def sparse_lines(draw: int = 0) -> Raw:
    """Return the plant under four periods of a multisine on odd lines, some left out."""
    rng = np.random.default_rng(18)
    lines = np.array([k for k in range(1, 40, 2) if k % 3])
    phases = 2.0 * np.pi * (np.arange(256)[:, None] * lines / 256 + rng.random(len(lines)))
    drive = InputSignal("u", "", (0.0, PERIOD_S), np.tile(np.cos(phases).sum(axis=1), 4), "zoh")
    stamps = PERIOD_S * np.arange(1, 1024)
    return _raw(drive, stamps, outputs_of(drive, stamps, 19 + _DRAW * draw))


@functools.cache
def stepped(draw: int = 0) -> Raw:
    """Return the plant under two sines, one after the other."""
    times = PERIOD_S * np.arange(1400)
    hertz = STEPS[0]
    values = np.where(
        times < 7.0, np.sin(2.0 * np.pi * hertz[0] * times), np.sin(2.0 * np.pi * hertz[1] * times)
    )
    drive = InputSignal("u", "", (0.0, PERIOD_S), values, "zoh")
    stamps = PERIOD_S * np.arange(1, 1399)
    return _raw(drive, stamps, outputs_of(drive, stamps, 20 + _DRAW * draw))


@functools.cache
def hammered(draw: int = 0) -> Raw:
    """Return the plant under three blows of a half-sine of 30 ms."""
    blow = 20.0 * np.sin(np.pi * np.arange(31) / 30)  # at a rate of 1 kHz
    force = np.zeros(18000)
    for start in (500, 6500, 12500):
        force[start : start + 31] = blow
    drive = InputSignal("u", "", (0.0, 0.001), force, "linear")
    stamps = PERIOD_S * np.arange(1, 1799)
    return _raw(drive, stamps, outputs_of(drive, stamps, 13 + _DRAW * draw))


@functools.cache
def plucked(draw: int = 0) -> Raw:
    """Return a free decay of the plant; its input stands still."""
    stamps = PERIOD_S * np.arange(500)
    damped = OMEGA * np.sqrt(1.0 - ZETA**2)
    clean = np.exp(-ZETA * OMEGA * stamps) * np.cos(damped * stamps)
    rng = np.random.default_rng(14 + _DRAW * draw)
    seen = {name: gain * clean + NOISE * rng.standard_normal(len(stamps)) for name, gain in GAINS.items()}
    drive = InputSignal("u", "", (0.0, PERIOD_S), np.zeros(501), "zoh")
    return _raw(drive, stamps, seen)


@functools.cache
def looped(draw: int = 0) -> Raw:
    """Return the plant under a slow controller that holds 0.1 of the deviation from a random reference."""
    reference = np.repeat(np.random.default_rng(15).choice([-10.0, 10.0], 64), 12)
    n = len(reference)
    pulse = InputSignal("u", "", (0.0, PERIOD_S), np.eye(1, n)[0], "zoh")
    weights = PLANT.simulate(pulse, PERIOD_S * np.arange(n))
    noise = NOISE * np.random.default_rng(16 + _DRAW * draw).standard_normal(n)
    drive, seen = np.zeros(n), np.zeros(n)
    for k in range(n):
        seen[k] = weights[1 : k + 1] @ drive[:k][::-1] + noise[k]
        drive[k] = 0.1 * (reference[k] - seen[k])
    signal = InputSignal("u", "", (0.0, PERIOD_S), drive, "zoh")
    return _raw(signal, PERIOD_S * np.arange(n), {"y": seen}, reference=reference)


@functools.cache
def moved(draw: int = 0) -> Raw:
    """Return the plant on a base whose position is known, filmed with 5 ms of exposure."""
    n = 2
    beam = ModalModel(
        structure="base_motion", input_name="u", output_names=tuple(GAINS), natural_frequencies=np.array([OMEGA]),
        damping_ratios=np.array([ZETA]), residues=np.array([[1.2], [-0.6]]), residual_terms=np.zeros(n),
        gains=np.ones(n), latency=0.0, clock_rate=0.0, covariance=np.zeros((2 + 2 + n * 3, 2 + 2 + n * 3)),
        noise_sd=np.ones(n),
    )  # fmt: skip
    hub = LogChirp(start_frequency=1.0, end_frequency=12.0, duration=5.0, still=2.0).sample(2e-3)
    drive = hub.input_signal("position", "u")
    stamps = PERIOD_S * np.arange(1, 690)
    rng = np.random.default_rng(17 + _DRAW * draw)
    noise = 1e-3 * float(np.std(drive.values))
    clean = beam.simulate(drive, stamps, exposure_s=5e-3)
    seen = {name: clean[:, j] + noise * rng.standard_normal(len(stamps)) for j, name in enumerate(GAINS)}
    return _raw(drive, stamps, seen, exposure_s=5e-3)


EXPERIMENTS: Mapping[str, Callable[[int], Raw]] = {
    "shaken": shaken,
    "shaken for long": shaken_long,
    "shaken, velocities": lambda draw: shaken(draw, 1),
    "shaken, accelerations": lambda draw: shaken(draw, 2),
    "sparse lines": sparse_lines,
    "stepped": stepped,
    "hammered": hammered,
    "plucked": plucked,
    "looped": looped,
    "moved": moved,
}
