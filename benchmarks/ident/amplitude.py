"""Do the bands over amplitude hold the whole curve as often as they say, and is a linear decay called linear?

Every run draws an oscillator of its class, its noise (a thousandth to a hundredth of the first swing) and the noise's
samples. What is true is read off maxima and zero crossings of the same motion without noise. The strip is that of the
rig, bent far and in air, as a camera sees it: averaged over exposures, with two markers that have stamps of their
own, and with lost frames.
"""

from __future__ import annotations

import time
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from beam_ident import (
    AmplitudeCurves,
    EstimationError,
    OutputSignal,
    amplitude_curves,
    driven_amplitude_curves,
    identify,
)
from beam_model import AirDrag, BeamModel, Damping
from beam_model.dynamics.nonlinear import NonlinearMotionStepper, NonlinearTerms
from benchmarks.ident.study import Outcome, Study
from tests.beam_ident.amplitude.oscillators import UNIT, Oscillator, driven_record, noisy, read_off
from tests.beam_model.rigs import strip

Truth = tuple[np.ndarray, np.ndarray, np.ndarray]
DURATION_S = 15.0


def judged(seconds: float, curves: AmplitudeCurves, truth: Truth) -> Outcome:
    """Return where the curves lie beside the truth: maxima, frequencies [Hz] and damping ratios, falling."""
    A, frequencies, ratios = (values[::-1] for values in truth)
    seen = (curves.amplitudes > A[0]) & (curves.amplitudes < A[-1])
    figures = {"one pole": float(curves.is_one_pole)}
    for name, values, own, sd, band in (
        ("frequency", frequencies, curves.frequencies_hz, curves.frequency_sd_hz, curves.frequency_band_hz),
        ("damping", ratios, curves.damping_ratios, curves.damping_sd, curves.damping_band),
    ):
        expected = np.interp(curves.amplitudes[seen], A, values)
        held = (expected >= band[0][seen]) & (expected <= band[1][seen])
        scores = (own[seen] - expected) / sd[seen]
        figures[f"{name} inside"] = float(np.all(held))
        for place in (0.25, 0.75):
            figures[f"{name} z {place}"] = float(scores[int(place * len(scores))])
    return Outcome(seconds, figures=figures)


class Bands:
    """Free decays of a class of oscillators; ``ranges`` are those of the fields of `Oscillator`."""

    def __init__(self, **ranges: tuple[float, float]) -> None:
        self.ranges = {"zeta": (0.002, 0.008), **ranges}

    def run(self, seed: int) -> Outcome:
        """Draw a decay and follow it."""
        rng = np.random.default_rng([seed, 1])
        oscillator = Oscillator(**{name: rng.uniform(*ends) for name, ends in self.ranges.items()})
        noise = UNIT * 10.0 ** rng.uniform(-3.0, -2.0)
        return self.followed(noisy(oscillator, noise, seed, DURATION_S), oscillator.curves(DURATION_S))

    @staticmethod
    def followed(decay: OutputSignal | list[OutputSignal], truth: Truth) -> Outcome:
        """Estimate the curves of a decay."""
        start = time.perf_counter()
        try:
            curves = amplitude_curves(decay)
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        return judged(time.perf_counter() - start, curves, truth)

    @staticmethod
    def summarise(outcomes: list[Outcome]) -> dict[str, Any]:
        """Return how often the bands hold the whole curves, and how errors compare with their deviations."""
        good = [o.figures for o in outcomes if o.figures]
        result: dict[str, Any] = {"failures": len(outcomes) - len(good)}
        for name in good[0] if good else ():
            values = np.array([figures[name] for figures in good])
            if " z " in name:
                result[f"{name}, rms"] = round(float(np.sqrt(np.mean(values**2))), 2)
                result[f"{name}, mean"] = round(float(np.mean(values)), 2)
            else:
                result[name] = round(float(np.mean(values)), 4)
        return result


class DrivenBands(Bands):
    """Three levels of a multisine about the mode."""

    levels = (1.0, 0.5, 0.25)

    def run(self, seed: int) -> Outcome:
        """Draw an oscillator, drive it, and identify it with one mode first."""
        rng = np.random.default_rng([seed, 1])
        oscillator = Oscillator(**{name: rng.uniform(*ends) for name, ends in self.ranges.items()})
        noise = UNIT * 10.0 ** rng.uniform(-2.7, -2.0)
        records = [
            driven_record(oscillator, 10 * seed + k, level, noise, 12.0)
            for k, level in enumerate(self.levels)
        ]
        start = time.perf_counter()
        try:
            curves = driven_amplitude_curves(records, identify(records, n_modes=1).model)
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        return judged(time.perf_counter() - start, curves, oscillator.curves(DURATION_S))


class FilmedStrip(Bands):
    """Decays of the rig's strip with large deflections and air drag; motions are simulated once, films drawn."""

    heights, period_s, exposure_s, readout_s = (0.285, 0.225), 5e-4, 5e-3, 2e-3
    drags, first_swings = (1.5, 3.0, 4.5, 6.0), (0.015, 0.02, 0.025, 0.03)

    def __init__(self) -> None:
        self.times = self.period_s * np.arange(round((DURATION_S + 0.1) / self.period_s) + 1)

    @cached_property
    def strips(self) -> list[tuple[np.ndarray, Truth]]:
        """Motions with what is true of each."""
        result = []
        for drag, swing in zip(self.drags, self.first_swings, strict=True):
            # Without the second mode's own ringing, zero crossings are those of the first.
            pure = CubicSpline(self.times, self.motion(drag, swing, 0.0, 0.3)[:, 0])
            fine = np.arange(0.0, self.times[-1], self.period_s / 4.0)
            result.append((self.motion(drag, swing, 2e-3, 0.005), read_off(fine, pure(fine))))
        return result

    def motion(self, drag: float, swing: float, second_mode: float, upper_damping: float) -> np.ndarray:
        """Return the heights' deflections, let go in the first mode's shape with a share of the second."""
        ratios = (0.005, upper_damping, upper_damping)
        n = len(ratios)
        model = BeamModel(strip(gravity="upright", damping=Damping(ratios=ratios)), n_modes=n)
        shapes = model.shape(np.array(self.heights))
        terms = NonlinearTerms(model, AirDrag(0.025, drag))
        stepper = NonlinearMotionStepper(model, self.period_s, terms)
        state = np.zeros(2 * n)
        state[:2] = swing / shapes[0, 0], second_mode * swing / abs(shapes[0, 1])
        stepper.state = state
        return np.asarray(stepper.run(np.zeros(len(self.times) - 1))[:, :n] @ shapes.T)

    def run(self, seed: int) -> Outcome:
        """Film one of the motions."""
        rng = np.random.default_rng([seed, 1])
        motion, truth = self.strips[seed % len(self.strips)]
        noise = 5e-6 * 10.0 ** rng.uniform(0.0, 0.8)
        decay = []
        for k, height in enumerate(self.heights):
            moved = CubicSpline(self.times, motion[:, k]).antiderivative()
            stamps = rng.uniform(0.01, 0.02) + np.arange(0.0, DURATION_S, 0.01) + k * self.readout_s
            stamps = stamps[rng.random(len(stamps)) > 0.01]
            ends = stamps + 0.5 * self.exposure_s, stamps - 0.5 * self.exposure_s
            seen = (moved(ends[0]) - moved(ends[1])) / self.exposure_s
            values = seen + noise * rng.standard_normal(len(stamps))
            decay.append(
                OutputSignal(f"z{round(1e3 * height)}", "m", stamps, values, exposure_s=self.exposure_s)
            )
        return self.followed(decay, truth)


STUDIES = {
    "amplitude-linear": Study("bands over amplitude, linear decay", 200, Bands),
    "amplitude-cubic": Study(
        "bands over amplitude, cubic spring", 200, lambda: Bands(hardening=(-0.01, 0.01))
    ),
    "amplitude-coulomb": Study("bands over amplitude, dry friction", 200, lambda: Bands(dry=(1e-4, 6e-4))),
    "amplitude-quadratic": Study(
        "bands over amplitude, quadratic damping", 200, lambda: Bands(quadratic=(1e-3, 8e-3))
    ),
    "amplitude-all": Study(
        "bands over amplitude, spring and friction and drag",
        200,
        lambda: Bands(hardening=(-0.01, 0.01), dry=(1e-4, 6e-4), quadratic=(1e-3, 8e-3)),
    ),
    "amplitude-strip": Study("bands over amplitude, filmed strip in air", 200, FilmedStrip),
    "amplitude-driven": Study(
        "bands over amplitude, three driven levels",
        100,
        lambda: DrivenBands(
            zeta=(0.004, 0.008), hardening=(-0.005, 0.005), dry=(0.0, 4e-4), quadratic=(0.0, 4e-3)
        ),
    ),
}
