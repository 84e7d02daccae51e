"""A lightly damped beam of three modes under force, seen at two points."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from beam_ident import InputSignal, ModalModel, ModalStructure, OutputSignal, Prior, TimeRecord, identify
from benchmarks.ident.study import AgainstBound, Outcome, Study

FREE, FIXED = Prior(0.0, np.inf), Prior(0.0, 0.0)
Make = Callable[["ForcedBeam", int, float], TimeRecord]


class ForcedBeam:
    """The three-mode beam under force: 2.3, 14.4 and 40 Hz, 200 samples a second, two points."""

    omegas = 2.0 * np.pi * np.array([2.3, 14.4, 40.0])
    zetas = np.array([0.02, 0.01, 0.005])
    gains = np.array([[1.0, -0.25, 0.08], [0.05, 0.08, -0.06]])
    period = 0.005
    n = 10000
    names = ("tip", "root")
    sweep_hz = (0.5, 50.0)

    def __init__(self) -> None:
        times = self.period * np.arange(self.n)
        low, high = self.sweep_hz
        phase = 2.0 * np.pi * (low * times + 0.5 * (high - low) / times[-1] * times**2)
        self.drive = InputSignal("force", "N", (0.0, self.period), np.sin(phase), "zoh")
        size = 2 * len(self.omegas) + 2 + 2 * (len(self.omegas) + 2)
        self.model = ModalModel(
            "receptance",
            "force",
            self.names,
            self.omegas,
            self.zetas,
            self.gains * self.omegas**2,
            np.zeros(2),
            np.zeros(2),
            0.0,
            0.0,
            np.zeros((size, size)),
            np.ones(2),
        )
        self.truth = np.concatenate([self.omegas, self.zetas])

    def record(
        self,
        seed: int,
        snr_db: float,
        stamps: np.ndarray | None = None,
        true_times: np.ndarray | None = None,
        drift: tuple[float, float] = (0.0, 0.0),
        start_s: float = 0.0,
        quiet: float = 1.0,
    ) -> TimeRecord:
        """Return a noisy record; ``quiet`` scales the noise, for the bound."""
        if stamps is None:
            stamps = self.period * np.arange(self.n)
        clean = self.model.simulate(self.drive, stamps if true_times is None else true_times)
        sigma = np.std(clean, axis=0) / 10 ** (snr_db / 20)
        noisy = clean + quiet * sigma * np.random.default_rng(seed).standard_normal(clean.shape)
        noisy = noisy + sigma * (drift[0] + drift[1] * (stamps / stamps[-1])[:, None])
        outputs = tuple(OutputSignal(name, "m", stamps, noisy[:, j]) for j, name in enumerate(self.names))
        record = TimeRecord((self.drive,), outputs)
        return record if start_s == 0.0 else record.between(start_s, 1e9)


PLAIN = ModalStructure("receptance", False, False, False, False)
DRIFTING = ModalStructure("receptance", False, True, True, True)


def jittered(snr_db: float) -> Make:
    """Return records whose stamps scatter by a tenth of the period."""

    def make(beam: ForcedBeam, seed: int, quiet: float) -> TimeRecord:
        scatter = np.random.default_rng([seed, 77]).uniform(-0.1, 0.1, beam.n)
        stamps = np.clip(beam.period * (np.arange(beam.n) + scatter), 0.0, None)
        stamps[0] = 0.0
        return beam.record(seed, snr_db, stamps, quiet=quiet)

    return make


def foreign_clock(beam: ForcedBeam, seed: int, quiet: float) -> TimeRecord:
    """Return records of a camera that is 2 ms late, runs fast by 0.1 % and drops ten frames."""
    times = beam.period * np.arange(10, beam.n - 30)
    dropped = np.random.default_rng(5).choice(len(times), 10, replace=False)
    times = np.delete(times, dropped)
    middle = 0.5 * (times[0] + times[-1])
    stamps = middle + 2e-3 + (times - middle) * 1.001
    return beam.record(seed, 20.0, stamps, times, quiet=quiet)


def plain(snr_db: float) -> Make:
    """Return records with exact stamps."""
    return lambda beam, seed, quiet: beam.record(seed, snr_db, quiet=quiet)


def drifting(beam: ForcedBeam, seed: int, quiet: float) -> TimeRecord:
    """Return records that begin in motion, with an offset and a ramp."""
    return beam.record(seed, 20.0, drift=(20.0, 30.0), start_s=3.0, quiet=quiet)


class ForcedBeamCase(AgainstBound):
    """Natural frequencies and damping ratios without a hint; the bound is the information at the truth."""

    def __init__(
        self, make: Make, structure: ModalStructure = PLAIN, clock: tuple[Prior, Prior] = (FIXED, FIXED)
    ) -> None:
        self.beam = ForcedBeam()
        self.make, self.structure, self.clock = make, structure, clock
        quiet = identify(make(self.beam, 10**6, 1e-3), structure, 3, *clock).model
        self.bound = 1e3 * np.concatenate([quiet.natural_frequency_sd, quiet.damping_ratio_sd])
        self.truth = self.beam.truth

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes is a failure."""
        record = self.make(self.beam, seed, 1.0)
        start = time.perf_counter()
        model = identify(record, self.structure, None, *self.clock).model
        seconds = time.perf_counter() - start
        return Outcome.of_modes(seconds, model, 3)


class JitterCase(ForcedBeamCase):
    """Stamps that scatter, and what comes of the same records where they are taken for a clock's ticks."""

    def __init__(self, snr_db: float) -> None:
        super().__init__(jittered(snr_db))

    def run(self, seed: int) -> Outcome:
        """Identify one record with its stamps; the error of mode 3 without them goes along."""
        outcome = super().run(seed)
        beam = self.beam
        ticks = beam.period * np.arange(beam.n)
        record = self.make(beam, seed, 1.0)
        outputs = tuple(OutputSignal(o.name, o.unit, ticks, o.values) for o in record.outputs)
        model = identify(TimeRecord(record.inputs, outputs), self.structure, 3, *self.clock).model
        error = float(model.natural_frequencies[2] - beam.omegas[2])
        return dataclasses.replace(outcome, figures={"error without stamps": error})

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add by how much the variance of the third frequency rises where the jitter is ignored."""
        ignored = np.mean([o.figures["error without stamps"] ** 2 for o in outcomes])
        handled = np.mean([(o.estimate[2] - self.truth[2]) ** 2 for o in outcomes if o.estimate is not None])
        return super().summarise(outcomes) | {
            "variance of f3 without stamps": round(float(ignored / handled), 1)
        }


class ForeignClockCase(ForcedBeamCase):
    """A late and fast camera, of which nothing is known: its latency and clock rate are parameters too."""

    def __init__(self) -> None:
        super().__init__(foreign_clock, PLAIN, (FREE, FREE))
        quiet = identify(foreign_clock(self.beam, 10**6, 1e-3), PLAIN, 3, FREE, FREE).model
        self.bound = np.append(self.bound, 1e3 * np.array([quiet.latency_sd, quiet.clock_rate_sd]))
        # The middle about which the clock is fast is that of the stamps, themselves 2 ms late.
        self.truth = np.append(self.truth, [2e-3 * 1.001, 1e-3])

    def run(self, seed: int) -> Outcome:
        """Identify one record, and note how far R_T^2 stays below what its noise allows."""
        record = self.make(self.beam, seed, 1.0)
        clean = self.make(self.beam, seed, 0.0)
        start = time.perf_counter()
        found = identify(record, self.structure, None, *self.clock)
        seconds = time.perf_counter() - start
        model = found.model
        missing = 0.0
        for noisy, exact, fit in zip(record.outputs, clean.outputs, found.outputs, strict=True):
            ceiling = 1.0 - np.var(noisy.values - exact.values) / np.var(noisy.values)
            missing = max(missing, float(ceiling - fit.scores.r_squared))
        figures = {"R_T^2 below its ceiling": missing}
        if model.n_modes != 3:
            return Outcome(seconds, figures=figures)
        clock, clock_sd = (
            [model.latency, model.clock_rate],
            [model.latency_sd, model.clock_rate_sd],
        )
        return Outcome(
            seconds,
            np.concatenate([model.natural_frequencies, model.damping_ratios, clock]),
            np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd, clock_sd]),
            figures,
        )

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add the largest distance of R_T^2 from its ceiling."""
        worst = max(o.figures["R_T^2 below its ceiling"] for o in outcomes)
        return super().summarise(outcomes) | {"largest R_T^2 below its ceiling": round(worst, 6)}


class CommonPolesCase(AgainstBound):
    """Two points with common poles beside one of them, on the same records."""

    def __init__(self) -> None:
        self.both = ForcedBeamCase(plain(20.0))
        self.tip = ForcedBeamCase(
            lambda beam, seed, quiet: beam.record(seed, 20.0, quiet=quiet).select(["tip"])
        )
        self.truth = np.tile(self.both.truth, 2)
        self.bound = np.concatenate([self.both.bound, self.tip.bound])

    def run(self, seed: int) -> Outcome:
        """Identify one record at both points, and at the tip alone."""
        both, tip = self.both.run(seed), self.tip.run(seed)
        if both.estimate is None or both.sd is None or tip.estimate is None or tip.sd is None:
            return Outcome(both.seconds)
        return Outcome(
            both.seconds, np.concatenate([both.estimate, tip.estimate]), np.concatenate([both.sd, tip.sd])
        )

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add the gain in variance that was found, and that which the bounds predict."""
        good = [o.estimate for o in outcomes if o.estimate is not None and self.is_near(o)]
        found = np.mean(np.square(np.array(good) - self.truth), axis=0).reshape(2, -1)
        predicted = np.square(self.bound).reshape(2, -1)
        gain, expected = found[1] / found[0], predicted[1] / predicted[0]
        return super().summarise(outcomes) | {
            "variance gain": [round(float(g), 2) for g in gain],
            "of that predicted": [round(float(g), 3) for g in gain / expected],
        }


STUDIES = {
    **{
        f"beam-{snr}": Study(f"forced beam {snr} dB", 2000, lambda snr=snr: ForcedBeamCase(plain(float(snr))))
        for snr in (20, 10, 0)
    },
    "jitter-40": Study("jittered stamps 40 dB", 400, lambda: JitterCase(40.0)),
    "jitter-60": Study("jittered stamps 60 dB", 400, lambda: JitterCase(60.0)),
    "start": Study("unknown start, offset and ramp 20 dB", 400, lambda: ForcedBeamCase(drifting, DRIFTING)),
    "common-poles": Study("two points with common poles against one, 20 dB", 1000, CommonPolesCase),
    "clock": Study(
        "2 ms late, 0.1 % fast, 10 frames dropped 20 dB",
        400,
        ForeignClockCase,
    ),
}
