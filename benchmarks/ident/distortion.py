"""Nonlinear distortion from detection lines: a linear plant is left in peace, a nonlinear one is flagged."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from beam_ident import (
    InputSignal,
    ModalModel,
    OutputSignal,
    TimeRecord,
    nonlinear_distortion,
    periodic_response,
)
from beam_model import BeamModel, BeamParameters, Damping
from beam_model.dynamics.nonlinear import AirDrag, NonlinearMotionStepper, NonlinearTerms
from benchmarks.ident.study import Outcome, Study

LINE_PERIOD_S, N_PERIODS, LEAD = 10.0, 6, 12
TICK_S = 1e-3
SIGNIFICANCE = 0.01


def random_odd_lines(low_hz: float, high_hz: float, seed: int = 0) -> np.ndarray:
    """Return odd lines [Hz], one of every four successive ones left out at random."""
    numbers = np.arange(round(low_hz * LINE_PERIOD_S) | 1, round(high_hz * LINE_PERIOD_S) + 1, 2)
    rng = np.random.default_rng(seed)
    groups = [numbers[k : k + 4] for k in range(0, len(numbers), 4)]
    return (
        np.concatenate([np.delete(g, rng.integers(len(g))) if len(g) == 4 else g for g in groups])
        / LINE_PERIOD_S
    )


class Distortion(ABC):
    """Steady periods at one output, white noise drawn anew in every run; the share of runs that is flagged."""

    def __init__(self) -> None:
        self.lines_hz = random_odd_lines(1.0, 20.0)
        n = round(LINE_PERIOD_S / TICK_S)
        one = TICK_S * np.arange(n)
        phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, len(self.lines_hz))
        omegas = 2.0 * np.pi * self.lines_hz
        period = sum(np.sin(w * one + p) for w, p in zip(omegas, phases, strict=True))
        self.accelerations = self.rms * np.tile(period / np.std(period), LEAD + N_PERIODS)
        self.first = LEAD * n
        self.step = 10
        self.output, self.drive = self.simulate()
        self.stamps = TICK_S * np.arange(self.first, len(self.accelerations), self.step)
        self.noise = self.noise_share * float(np.std(self.output))

    rms = 1.0
    noise_share = 1e-3

    @abstractmethod
    def simulate(self) -> tuple[np.ndarray, InputSignal]:
        """Return the steady output and the input."""

    def run(self, seed: int) -> Outcome:
        """Judge one record."""
        noisy = self.output + self.noise * np.random.default_rng(seed).standard_normal(len(self.output))
        record = TimeRecord((self.drive,), (OutputSignal("w", "m", self.stamps, noisy),))
        start = time.perf_counter()
        found = nonlinear_distortion(periodic_response(record, LINE_PERIOD_S, self.lines_hz), SIGNIFICANCE)
        seconds = time.perf_counter() - start
        levels = {level.parity: level.level_db for level in found.levels}
        return Outcome(seconds, figures={"flagged": float(found.is_nonlinear), **levels})

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the share of flagged runs and the median levels."""
        figures = [o.figures for o in outcomes]
        return {
            "flagged": round(float(np.mean([f["flagged"] for f in figures])), 4),
            "even dB": round(float(np.median([f["even"] for f in figures])), 1),
            "odd dB": round(float(np.median([f["odd"] for f in figures])), 1),
        }


class LinearBeam(Distortion):
    """The first two modes of a strip on a moved base: 4.4 and 28 Hz, 2 % of damping."""

    def simulate(self) -> tuple[np.ndarray, InputSignal]:
        """Return the deflection of the linear model."""
        omegas = 2.0 * np.pi * np.array([4.4, 28.3])
        model = ModalModel(
            "acceleration",
            "hub",
            ("w",),
            omegas,
            np.array([0.02, 0.02]),
            np.array([[1.5, -0.75]]),
            np.zeros(1),
            np.zeros(1),
            0.0,
            0.0,
            np.zeros((10, 10)),
            np.ones(1),
        )
        drive = InputSignal("hub", "m/s^2", (0.0, TICK_S), self.accelerations)
        stamps = TICK_S * np.arange(self.first, len(self.accelerations), self.step)
        return model.simulate(drive, stamps)[:, 0], drive


class CubicSpring(Distortion):
    """``x'' + 2 zeta w x' + w^2 (x + x^3 / s^2) = -a``: rms deflections of 4 % of s make 0.5 % of distortion."""

    stiffening = 0.04

    def simulate(self) -> tuple[np.ndarray, InputSignal]:
        """Return the deflection by Runge-Kutta steps of one tick, the input held."""
        omega, zeta = 2.0 * np.pi * 4.4, 0.02
        linear = self._integrated(omega, zeta, 0.0)
        cubic = omega**2 * (self.stiffening / float(np.std(linear[self.first :]))) ** 2
        drive = InputSignal("hub", "m/s^2", (0.0, TICK_S), self.accelerations)
        return self._integrated(omega, zeta, cubic)[self.first :: self.step], drive

    def _integrated(self, omega: float, zeta: float, cubic: float) -> np.ndarray:
        def rate(x: float, v: float, a: float) -> tuple[float, float]:
            return v, -a - 2.0 * zeta * omega * v - omega**2 * x - cubic * x * x * x

        h, x, v = TICK_S, 0.0, 0.0
        found = np.empty(len(self.accelerations))
        for k, a in enumerate(self.accelerations.tolist()):
            found[k] = x
            k1 = rate(x, v, a)
            k2 = rate(x + 0.5 * h * k1[0], v + 0.5 * h * k1[1], a)
            k3 = rate(x + 0.5 * h * k2[0], v + 0.5 * h * k2[1], a)
            k4 = rate(x + h * k3[0], v + h * k3[1], a)
            x += h / 6.0 * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0])
            v += h / 6.0 * (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1])
        return found


class LargeBeam(Distortion):
    """The rig's strip with geometric terms and air drag, tip amplitudes of some centimetres."""

    rms = 1.5

    def simulate(self) -> tuple[np.ndarray, InputSignal]:
        """Return the tip's deflection."""
        parameters = BeamParameters.from_section(
            0.30,
            0.025,
            0.0005,
            7850.0,
            200e9,
            hub_mass=0.8,
            gravity="upright",
            damping=Damping(ratios=(0.02,)),
        )
        model = BeamModel(parameters, n_modes=3)
        stepper = NonlinearMotionStepper(model, TICK_S, NonlinearTerms(model, AirDrag(0.025)))
        shape = np.asarray(model.shape(np.array([0.285]))).ravel()
        found = stepper.run(self.accelerations)[:-1, : model.n_modes] @ shape
        drive = InputSignal("hub", "m/s^2", (0.0, TICK_S), self.accelerations)
        return found[self.first :: self.step], drive


STUDIES = {
    "distortion-linear": Study("detection lines, linear beam", 1000, LinearBeam),
    "distortion-cubic": Study("detection lines, cubic spring", 200, CubicSpring),
    "distortion-beam": Study("detection lines, strip at large amplitude", 200, LargeBeam),
}
