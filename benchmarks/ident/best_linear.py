"""Best linear approximations: do the bands of noise and distortion hold the true variances, line by line?

Systems whose variances are known from outside of the library: a static polynomial before a resonance, where they are
a sum over all combinations of lines, and a mass with dry friction or on a stiffening spring, in a sampled loop or
under a known force, where 4000 realisations show them.  Simulated apart from the library; every run is a study of M
realisations with other phases.
"""

from __future__ import annotations

import functools
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from beam_ident import (
    BestLinearApproximation,
    InputSignal,
    LineVariances,
    OutputSignal,
    TimeRecord,
    best_linear_approximation,
)
from benchmarks.ident.study import Outcome, Study

M, P = 7, 4
TRUTH_REALISATIONS = 4000


@dataclass(frozen=True)
class Truth:
    """Response and variances of one realisation's response at the excited, the odd and the even lines."""

    response: np.ndarray
    distortion: dict[str, np.ndarray]
    noise: dict[str, np.ndarray]


@dataclass(frozen=True)
class Signals:
    """Periods of M realisations, each of shape (M, P, N); the reference is the same in all periods, (M, N)."""

    reference: np.ndarray
    drive: np.ndarray
    output: np.ndarray


def random_odd(first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Return odd line numbers with one of every four left out, and those left out."""
    odd = np.arange(first, last + 1, 2)
    out = np.arange(2, len(odd) - 1, 4)
    return np.delete(odd, out), odd[out]


class BandStudy(ABC):
    """One study a run: which bands hold the truth."""

    period_s: float
    n_samples: int
    excited: np.ndarray
    odd: np.ndarray
    even: np.ndarray
    is_loop: bool

    @abstractmethod
    def simulate(self, rng: np.random.Generator, realisations: int) -> Signals:
        """Return steady periods."""

    @property
    @abstractmethod
    def truth(self) -> Truth:
        """What the bands must hold."""

    def phases(self, rng: np.random.Generator, realisations: int) -> np.ndarray:
        """Return periods of a multisine of unit rms with random phases, shape (realisations, n_samples)."""
        spectrum = np.zeros((realisations, self.n_samples // 2 + 1), dtype=np.complex128)
        turns = np.exp(2j * np.pi * rng.uniform(size=(realisations, len(self.excited))))
        spectrum[:, self.excited] = turns * self.n_samples / np.sqrt(2.0 * len(self.excited))
        return np.fft.irfft(spectrum, self.n_samples, axis=1)

    def records(self, signals: Signals) -> list[TimeRecord]:
        """Return every realisation as a record; a signal without content above half the rate between the samples."""
        step = self.period_s / self.n_samples
        records = []
        for r, u, y in zip(signals.reference, signals.drive, signals.output, strict=True):
            drive = InputSignal("u", "N", (0.0, step), u.ravel(), "band_limited")
            command = InputSignal("r", "m", (0.0, step), np.tile(r, len(u)), "band_limited")
            inputs = (drive, command) if self.is_loop else (drive,)
            records.append(TimeRecord(inputs, (OutputSignal("y", "m", (0.0, step), y.ravel()),)))
        return records

    def approximation(self, signals: Signals) -> BestLinearApproximation:
        """Return what the library says of the signals."""
        return best_linear_approximation(
            self.records(signals),
            self.period_s,
            self.excited / self.period_s,
            skip_periods=0,
            input_name="u",
            reference_name="r" if self.is_loop else None,
        )

    def run(self, seed: int) -> Outcome:
        """Estimate from one study."""
        signals = self.simulate(np.random.default_rng(seed), M)
        start = time.perf_counter()
        found = self.approximation(signals)
        seconds = time.perf_counter() - start
        figures = {}
        for where in ("excited", "odd", "even"):
            figures |= self._held(where, getattr(found, where))
        z = (found.response[:, 0] - self.truth.response) / np.sqrt(found.total_covariance[:, 0, 0].real)
        figures["squared z of the response"] = float(np.mean(np.abs(z) ** 2))
        figures["called nonlinear"] = float(not found.verdict.startswith("linear"))
        return Outcome(seconds, figures=figures)

    def _held(self, where: str, lines: LineVariances) -> dict[str, float]:
        truth = self.truth
        found = {}
        for what, known, band, value in (
            ("distortion", truth.distortion[where], lines.distortion_band(), lines.total - lines.noise),
            ("noise", truth.noise[where], lines.noise_band(), lines.noise),
        ):
            held = (band[0, :, 0] <= known) & (known <= band[1, :, 0])
            found[f"{what} held, {where}"] = float(np.mean(held))
            if np.all(known > 0.0):
                found[f"{what} over truth, {where}"] = float(np.mean(value[:, 0] / known))
        return found

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the means over all studies."""
        return {
            name: round(float(np.mean([o.figures[name] for o in outcomes])), 4)
            for name in outcomes[0].figures
        }


class Polynomial(BandStudy):
    """``u + b u^2 + c u^3`` before a resonance: open loop, the input known or measured with noise."""

    period_s, n_samples, is_loop = 1.0, 512, False
    square, cube = 0.1, 0.1
    output_noise, input_noise = 0.1, 0.0

    def __init__(self) -> None:
        self.excited, self.odd = random_odd(1, 119)
        self.even = np.arange(2, self.excited[-1], 2)
        z = np.exp(2j * np.pi * np.arange(self.n_samples // 2 + 1) / self.n_samples)
        pole = 0.98 * np.exp(2j * np.pi * 40.0 / self.n_samples)
        self.plant = 0.06 * z / np.abs(1.0 - pole) / ((1.0 - pole / z) * (1.0 - np.conj(pole) / z)) / z

    def simulate(self, rng: np.random.Generator, realisations: int) -> Signals:
        """Return steady periods: a static polynomial has no transient, the resonance is a product of spectra."""
        u = self.phases(rng, realisations)
        bent = u + self.square * u**2 + self.cube * u**3
        y = np.fft.irfft(np.fft.rfft(bent, axis=1) * self.plant, self.n_samples, axis=1)
        shape = (realisations, P, self.n_samples)
        return Signals(
            u,
            u[:, None] + self.input_noise * rng.standard_normal(shape),
            y[:, None] + self.output_noise * rng.standard_normal(shape),
        )

    @functools.cached_property
    def truth(self) -> Truth:
        """The variances by counting: terms of other phase sums are uncorrelated, and add their powers.

        A multiset of lines that occurs in p orders gives p^2 of power, p in each order; one that holds a line and its
        negative has the phase of the line that is left, and belongs to the response.
        """
        signed = np.concatenate([self.excited, -self.excited])
        power = 0.5 / len(self.excited)  # |coefficient|^2 of a line, two-sided
        distortion, noise = {}, {}
        for where, lines in (("excited", self.excited), ("odd", self.odd), ("even", self.even)):
            gain = np.abs(self.plant[lines]) ** 2 / power
            pairs = np.array([_power_of_pairs(k, signed) for k in lines]) * power**2
            triples = np.array([_power_of_triples(k, signed) for k in lines]) * power**3
            distortion[where] = gain * (self.square**2 * pairs + self.cube**2 * triples)
            # The gain of the response itself carries the noise of the input over.
            linear = np.abs(self._response(lines)) ** 2 * (self.input_noise**2)
            noise[where] = (self.output_noise**2 + linear) / self.n_samples / P / power
        return Truth(self._response(self.excited), distortion, noise)

    def _response(self, lines: np.ndarray) -> np.ndarray:
        # Of u^3, a line of amplitude a among others of the variance s^2 has (3 s^2 - 3 a^2 / 4) u.
        amplitude = np.sqrt(2.0 / len(self.excited))
        return self.plant[lines] * (1.0 + self.cube * (3.0 - 0.75 * amplitude**2))


def _power_of_pairs(k: int, signed: np.ndarray) -> float:
    first = signed[np.isin(k - signed, signed)]
    second = k - first
    return float(np.sum(np.where(first == second, 1.0, 2.0) * (first != -second)))


def _power_of_triples(k: int, signed: np.ndarray) -> float:
    first, second = (own.ravel() for own in np.meshgrid(signed, signed))
    third = k - first - second
    is_one = np.isin(third, signed) & (first != -second) & (first != -third) & (second != -third)
    a, b, c = first[is_one], second[is_one], third[is_one]
    equal = (a == b).astype(int) + (b == c) + (a == c)
    return float(np.sum(np.where(equal == 3, 1.0, np.where(equal == 1, 3.0, 6.0))))


class NoisyInput(Polynomial):
    """The same with noise on the measured input."""

    input_noise = 0.1


class LinearLoopless(Polynomial):
    """Without the polynomial: how often is a linear system called nonlinear?"""

    square = cube = 0.0


class FrictionLoop(BandStudy):
    """A mass with viscous and dry friction under a sampled position controller; noise of the sensor goes around.

    From the force to the position, with the commanded position as reference. The variances are those of 4000
    realisations of other seeds. Without the loop the force is the command times the spring's stiffness.
    """

    period_s, n_samples, is_loop = 2.0, 512, True
    mass, viscous, dry, spring, cube = 1.0, 6.0, 1.5, 0.0, 0.0
    stiffness, damping = 900.0, 40.0
    rms, sensor_noise, force_noise = 0.02, 2e-4, 0.0
    substeps, settle = 4, 3
    first = 5  # below 2.5 Hz dry friction takes most of the force: there the response is no response any more

    def __init__(self) -> None:
        self.excited, self.odd = random_odd(self.first, 65)
        self.even = np.arange(self.first + 1, self.excited[-1], 2)

    def simulate(self, rng: np.random.Generator, realisations: int) -> Signals:
        """Return steady periods by small implicit steps, in which dry friction stops and holds the mass exactly."""
        r = self.rms * self.phases(rng, realisations)
        x, v, last = (np.zeros(realisations) for _ in range(3))
        step = self.period_s / self.n_samples
        h = step / self.substeps
        drive, output = (np.empty((realisations, P, self.n_samples)) for _ in range(2))
        for number in range(self.settle + P):
            for k in range(self.n_samples):
                seen = x + self.sensor_noise * rng.standard_normal(realisations)
                error = r[:, k] - seen
                force = self.stiffness * error + self.damping * (error - last) / step / 4.0
                if not self.is_loop:
                    force = self.spring * r[:, k]
                last = error
                if number >= self.settle:
                    output[:, number - self.settle, k] = seen
                    drive[:, number - self.settle, k] = force
                for _ in range(self.substeps):
                    pull = force - self.spring * x - self.cube * x**3
                    free = (v + h / self.mass * pull) / (1.0 + h * self.viscous / self.mass)
                    v = np.sign(free) * np.maximum(np.abs(free) - h * self.dry / self.mass, 0.0)
                    x = x + h * v
        drive += self.force_noise * rng.standard_normal(drive.shape)
        return Signals(r if self.is_loop else self.spring * r, drive, output)

    @functools.cached_property
    def truth(self) -> Truth:
        """What many realisations show, by their spectra alone."""
        rng = np.random.default_rng(10**6)
        parts = [self.simulate(rng, TRUTH_REALISATIONS // 4) for _ in range(4)]
        r, u, y = (
            np.fft.rfft(np.concatenate([getattr(part, name) for part in parts]), axis=-1) / self.n_samples
            for name in ("reference", "drive", "output")
        )
        mean_u, mean_y = np.mean(u, axis=1), np.mean(y, axis=1)
        response = np.zeros(r.shape[1], dtype=np.complex128)
        size = np.zeros(r.shape[1])
        lines = self.excited
        below = np.mean(np.conj(r) * mean_u, axis=0)
        response[lines] = np.mean(np.conj(r) * mean_y, axis=0)[lines] / below[lines]
        size[lines] = np.abs(below[lines]) ** 2 / np.mean(np.abs(r[:, lines]) ** 2, axis=0)
        every = np.arange(len(response))
        rest = np.setdiff1d(every, lines)
        # Between excited lines the inverse response, near a parabola for a mass on a spring, is a spline.
        inside = rest[(rest > lines[0]) & (rest < lines[-1])]
        response[inside] = 1.0 / CubicSpline(lines, 1.0 / response[lines])(inside)
        size[rest] = np.interp(rest, lines, size[lines])
        left = y - response * u
        total = np.mean(np.abs(np.mean(left, axis=1)) ** 2, axis=0)
        noise = np.mean(np.var(left, axis=1, ddof=1), axis=0) / P
        where = {"excited": self.excited, "odd": self.odd, "even": self.even}
        is_linear = self.dry == 0.0 and self.cube == 0.0
        power = {name: np.maximum(total - noise, 0.0)[own] / size[own] for name, own in where.items()}
        # Dry friction and the spring are the same in both directions: odd nonlinearities.
        none = {name: np.zeros(len(own)) for name, own in where.items() if is_linear or name == "even"}
        return Truth(
            response[lines], power | none, {name: noise[own] / size[own] for name, own in where.items()}
        )


class Friction(FrictionLoop):
    """The same friction in open loop: on a spring, under a known force."""

    is_loop = False
    spring, viscous = 900.0, 12.0


class CubicLoop(FrictionLoop):
    """A stiffening spring in the loop, which the swing makes stiffer by half on average; no dry friction."""

    dry = 0.0
    spring, cube = 400.0, 2e5


class LinearLoop(FrictionLoop):
    """The loop without a nonlinearity: how often is a linear system in it called nonlinear?"""

    dry = 0.0


STUDIES = {
    "best-linear-cubic": Study("best linear approximation, known input", 200, Polynomial),
    "best-linear-noisy-input": Study("best linear approximation, measured input", 200, NoisyInput),
    "best-linear-linear": Study("best linear approximation, linear system", 200, LinearLoopless),
    "best-linear-friction": Study("best linear approximation, friction", 200, Friction),
    "best-linear-friction-loop": Study("best linear approximation, friction in a loop", 200, FrictionLoop),
    "best-linear-cubic-loop": Study("best linear approximation, stiffening spring in a loop", 200, CubicLoop),
    "best-linear-linear-loop": Study("best linear approximation, linear system in a loop", 200, LinearLoop),
}
