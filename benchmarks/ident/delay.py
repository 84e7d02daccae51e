"""Unknown delays: the forced beam behind 7.3 ms, and a double pole behind 8 s."""

from __future__ import annotations

import functools
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import max_len_seq

from beam_ident import (
    InputSignal,
    ModalModel,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_transfer_function,
    identify,
)
from beam_ident.modal.identification_result import IdentificationResult
from benchmarks.ident.forced_beam import FIXED, FREE, PLAIN, ForcedBeam
from benchmarks.ident.study import AgainstBound, Outcome, Study

_QUIET = 1e-3  # of the noise: what the covariance states there is the bound


class DelayCase(AgainstBound):
    """One input through a known system and an unknown delay; degrees given, nothing else.

    The bound is the information at the truth, as an estimate with a thousandth of the noise states it.
    """

    truth_model: TransferFunctionModel
    drive: InputSignal
    stamps: np.ndarray
    snr_db: float

    def prepare(self) -> None:
        """Compute the output without noise."""
        self.clean = self.truth_model.simulate(self.drive, self.stamps)
        self.noise_sd = float(np.std(self.clean) / 10 ** (self.snr_db / 20))
        self.n_poles = self.truth_model.n_poles
        self.n_zeros = len(self.truth_model.numerator) - 1
        self.truth = self.truth_model.parameters

    @functools.cached_property
    def bound(self) -> np.ndarray:
        """Standard deviations at the limit."""
        return self.estimate(self.record(10**6, _QUIET)).standard_deviations / _QUIET

    def record(self, seed: int, quiet: float = 1.0) -> TimeRecord:
        """Return a noisy record; ``quiet`` scales the noise."""
        noise = quiet * self.noise_sd * np.random.default_rng(seed).standard_normal(len(self.clean))
        return TimeRecord((self.drive,), (OutputSignal("y", "", self.stamps, self.clean + noise),))

    def estimate(self, record: TimeRecord) -> TransferFunctionModel:
        """Estimate coefficients and delay."""
        return estimate_transfer_function(record, self.n_poles, self.n_zeros, delay="estimate").model

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add what became of the delay alone."""
        error = np.array([o.estimate[-1] - self.truth[-1] for o in outcomes if o.estimate is not None])
        sd = np.array([o.sd[-1] for o in outcomes if o.sd is not None])
        delay = {
            "delay rmse [ms]": round(1e3 * float(np.sqrt(np.mean(error**2))), 4),
            "delay max |z|": round(float(np.max(np.abs(error / sd))), 2),
        }
        return super().summarise(outcomes) | delay

    def run(self, seed: int) -> Outcome:
        """Estimate from one record."""
        record = self.record(seed)
        start = time.perf_counter()
        model = self.estimate(record)
        seconds = time.perf_counter() - start
        return Outcome(seconds, model.parameters, model.standard_deviations)


class DoublePole(DelayCase):
    """CONTSID's demonstration: 12/(s^2 + 4 s + 4) e^(-8 s), PRBS, 0.1 s, 15 dB."""

    snr_db = 15.0

    def __init__(self) -> None:
        self.truth_model = TransferFunctionModel(
            np.array([12.0]), np.array([1.0, 4.0, 4.0]), 8.0, np.zeros((4, 4)), 0.0
        )
        steps = np.repeat(2.0 * max_len_seq(8)[0] - 1.0, 5)
        self.drive = InputSignal("u", "", (0.0, 0.1), steps, "zoh")
        self.stamps = 0.1 * np.arange(len(steps))
        self.prepare()


class DelayedBeam(DelayCase):
    """The three-mode beam at its tip, 7.3 ms late: a fraction of a sample beside one, under a chirp."""

    snr_db = 20.0
    omegas = 2.0 * np.pi * np.array([2.3, 14.4, 40.0])
    zetas = np.array([0.02, 0.01, 0.005])
    gains = np.array([1.0, -0.25, 0.08])
    period = 0.005
    n = 10000

    def __init__(self) -> None:
        sections = [np.array([1.0, 2.0 * z * w, w * w]) for w, z in zip(self.omegas, self.zetas, strict=True)]
        denominator = np.polymul(np.polymul(sections[0], sections[1]), sections[2])
        numerator = np.zeros(5)
        for k, (gain, w) in enumerate(zip(self.gains, self.omegas, strict=True)):
            others = [section for j, section in enumerate(sections) if j != k]
            numerator += gain * w * w * np.polymul(*others)
        self.truth_model = TransferFunctionModel(numerator, denominator, 7.3e-3, np.zeros((12, 12)), 0.0)
        times = self.period * np.arange(self.n)
        phase = 2.0 * np.pi * (0.5 * times + 0.5 * 49.5 / times[-1] * times**2)
        self.drive = InputSignal("force", "N", (0.0, self.period), np.sin(phase), "zoh")
        self.stamps = times
        self.prepare()


class LateBeam(AgainstBound):
    """The same delay as the latency of a modal model, seen at two points: poles in common leave it little room."""

    delay = 7.3e-3

    def __init__(self) -> None:
        self.beam = ForcedBeam()
        self.times = self.beam.period * np.arange(10, self.beam.n - 10)
        self.truth = np.concatenate([self.beam.truth, [self.delay]])

    @functools.cached_property
    def bound(self) -> np.ndarray:
        """Standard deviations at the limit."""
        return self.flat(self.identify(10**6, _QUIET, 3))[1] / _QUIET

    def identify(self, seed: int, quiet: float = 1.0, n_modes: int | None = None) -> ModalModel:
        """Identify one record, the clock's rate known."""
        record = self.beam.record(seed, 20.0, self.times + self.delay, self.times, quiet=quiet)
        return identify(record, PLAIN, n_modes, FREE, FIXED).model

    @staticmethod
    def flat(model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies, damping ratios and latency, and their standard deviations."""
        sds = (model.natural_frequency_sd, model.damping_ratio_sd, [model.latency_sd])
        values = (model.natural_frequencies, model.damping_ratios, [model.latency])
        return np.concatenate(values), np.concatenate(sds)

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes is a failure."""
        start = time.perf_counter()
        model = self.identify(seed)
        seconds = time.perf_counter() - start
        return Outcome(seconds, *self.flat(model)) if model.n_modes == 3 else Outcome(seconds)


class LateOutput(LateBeam):
    """One of the two points late by itself, beside a latency of both: nobody says so."""

    own = 3e-3

    def __init__(self) -> None:
        super().__init__()
        self.truth = np.concatenate([self.beam.truth, [self.own]])

    def identify(self, seed: int, quiet: float = 1.0, n_modes: int | None = None) -> ModalModel:
        """Identify one record, the stamps of its second output late."""
        record = self.beam.record(seed, 20.0, self.times + self.delay, self.times, quiet=quiet)
        first, second = record.outputs
        late = replace(second, times_s=second.times_s + self.own)
        return identify(TimeRecord(record.inputs, (first, late)), PLAIN, n_modes, FREE, FIXED).model

    @staticmethod
    def flat(model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies, damping ratios and the second output's delay beside the first, and their deviations."""
        values, sds = LateBeam.flat(model)
        values[-1] = model.output_delays[1] - model.output_delays[0]
        sds[-1] = float(np.linalg.norm(model.output_delay_sd))
        return values, sds


def _steps(n: int) -> np.ndarray:
    """Return a binary sequence of n samples, every step held for two."""
    return (2.0 * max_len_seq(13)[0][: n // 2] - 1.0).repeat(2)


class JumpingClock(LateBeam):
    """A clock that jumps at some instant by 1 to 100 ms, either way as far as stamps still rise; or does not jump.

    The camera's and, in every fourth run, the input's.  The bound is that of stamps without a jump at a latency on
    each side.
    """

    start_s, end_s = 10.0, 40.0  # of where a jump may be

    def __init__(self) -> None:
        super().__init__()
        self.beam.drive = replace(self.beam.drive, values=_steps(self.beam.n))
        self.truth = self.beam.truth

    @functools.cached_property
    def bound(self) -> np.ndarray:
        """Standard deviations at the limit."""
        return self.flat(self.found(10**6 + 1, _QUIET, 3).model)[1] / _QUIET

    def jump(self, seed: int) -> tuple[float, float, bool]:
        """Return when and by how much [s] a clock jumps, not at all in every other run, and if it is the input's."""
        rng = np.random.default_rng([seed, 9])
        size = float(np.exp(rng.uniform(np.log(1e-3), np.log(0.1))))
        if size < 0.8 * self.beam.period and rng.random() < 0.5:
            size = -size
        return float(rng.uniform(self.start_s, self.end_s)), size * (seed % 2), seed % 4 == 3

    def record(self, seed: int, quiet: float = 1.0) -> TimeRecord:
        """Return a record whose stamps are 7.3 ms late, and scatter by 20 us, and jump."""
        at_s, size, is_input = self.jump(seed)
        scatter = 2e-5 * np.random.default_rng([seed, 5]).standard_normal(len(self.times))
        stamps = self.times + self.delay + scatter
        late = stamps + size * (stamps >= at_s) * (not is_input)
        record = self.beam.record(seed, 20.0, late, self.times + scatter, quiet=quiet)
        if not (is_input and size):
            return record
        (drive,) = record.inputs
        times = drive.times_s + size * (drive.times_s >= at_s)
        return TimeRecord((replace(drive, times_s=times),), record.outputs)

    def found(self, seed: int, quiet: float = 1.0, n_modes: int | None = None) -> IdentificationResult:
        """Identify one record, the clock's rate known."""
        return identify(self.record(seed, quiet), PLAIN, n_modes, FREE, FIXED)

    @staticmethod
    def flat(model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies and damping ratios, and their standard deviations."""
        values, sds = LateBeam.flat(model)
        return values[:-1], sds[:-1]

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes is a failure, and so is a jump that is missed or feigned."""
        at_s, size, _ = self.jump(seed)
        start = time.perf_counter()
        result = self.found(seed)
        seconds = time.perf_counter() - start
        jumps = result.clock_jumps
        figures = {"jumps": float(len(jumps)), "really": float(size != 0.0)}
        if len(jumps) == 1 and size:
            figures["samples apart"] = abs(jumps[0].at_s - at_s - max(size, 0.0)) / self.beam.period
            figures["z"] = (jumps[0].size_s - size) / jumps[0].size_sd
        is_right = len(jumps) == int(size != 0.0) and result.model.n_modes == 3
        estimate, sd = self.flat(result.model) if is_right else (None, None)
        return Outcome(seconds, estimate, sd, figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add how many jumps were found where there was one, and where there was none."""
        seen = [o.figures for o in outcomes]
        z = np.abs([own["z"] for own in seen if "z" in own])
        apart = [own["samples apart"] for own in seen if "samples apart" in own]
        return super().summarise(outcomes) | {
            "jumps": int(sum(own["really"] for own in seen)),
            "found": len(z),
            "false alarms": int(sum(own["jumps"] > 0 for own in seen if not own["really"])),
            "samples apart at most": round(max(apart, default=0.0), 1),
            "jump's size: coverage, max |z|": [
                round(float(np.mean(z < 1.96)), 3),
                round(float(np.max(z)), 2),
            ],
        }


STUDIES = {
    "clock-jump": Study("beam at two points whose clock jumps by 1 to 100 ms, 20 dB", 200, JumpingClock),
    "output-delays": Study(
        "beam at two points, one of them 3 ms late by itself, modal, 20 dB", 200, LateOutput
    ),
    "delay-beam-modes": Study("beam 7.3 ms late, two points, modal, 20 dB", 400, LateBeam),
    "delay-beam": Study("beam 7.3 ms late, 20 dB", 400, DelayedBeam),
    "delay-double-pole": Study("double pole 8 s late, 15 dB", 400, DoublePole),
}
