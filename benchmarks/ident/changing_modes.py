"""Modes whose frequencies change while they are recorded, integrated step by step from their equations of motion."""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any, Literal

import numpy as np

from beam_ident import IdentificationResult, InputSignal, OutputSignal, TimeRecord, identify
from benchmarks.ident.study import Outcome, Study


class ChangingModes:
    """Two modes of a strip on a moving base, at 3.1 and 11 Hz, seen at two points 100 times a second.

    Parameters
    ----------
    over : {"time", "swing"} or None
        Whether the first mode changes evenly from the first stamp to the last, or as Duffing's oscillator, or not.
    """

    omegas = 2.0 * np.pi * np.array([3.1, 11.0])
    zetas = np.array([0.008, 0.006])
    shapes = np.array([[1.5, -0.8], [0.9, 0.6]])
    step_s, noise = 1e-3, 5e-6

    def __init__(self, over: Literal["time", "swing"] | None, duration_s: float = 20.0) -> None:
        self.over, self.duration_s = over, duration_s

    def share(self, seed: int) -> float:
        """Return by which share the first mode's frequency changes: over time, or at an amplitude of 10 mm."""
        rng = np.random.default_rng([seed, 1])
        size = math.exp(rng.uniform(math.log(1e-3), math.log(1e-2)))
        return 0.0 if self.over is None else size * float(rng.choice([-1.0, 1.0]))

    def record(self, seed: int) -> TimeRecord:
        """Return a record under a random multisine of the base's acceleration."""
        rng = np.random.default_rng([seed, 2])
        lines = (
            2.0 * np.pi * np.arange(round(self.duration_s), round(15.0 * self.duration_s)) / self.duration_s
        )
        phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
        size = 0.8 / math.sqrt(len(lines))
        half = 0.5 * self.step_s * np.arange(round(2.0 * self.duration_s / self.step_s) + 1)
        turns = np.outer(half, lines) + phases
        base, acceleration = -size * np.cos(turns) @ (1.0 / lines**2), size * np.cos(turns).sum(axis=1)
        deflection = self._integrated(half, acceleration, self.share(seed))
        rows = slice(0, None, round(0.01 / self.step_s))
        times, seen = half[::2], base[::2][rows, None] + deflection[rows] @ self.shapes.T
        seen = seen + self.noise * rng.standard_normal(seen.shape)
        # Both are seen from when the modes already move until the end.
        begins = round(0.2 / self.step_s)
        drive = InputSignal("base", "m", (0.2, self.step_s), base[::2][begins:], "cubic")
        outputs = (
            OutputSignal(name, "m", times[rows][20:], seen[20:, j]) for j, name in enumerate(("tip", "root"))
        )
        return TimeRecord((drive,), tuple(outputs))

    def _integrated(self, half: np.ndarray, acceleration: np.ndarray, share: float) -> np.ndarray:
        """Return the modal deflections at every step, by the classical method of Runge and Kutta, (n_steps, 2)."""
        first, last = 0.2, half[-1]

        def slope(k: int, state: np.ndarray) -> np.ndarray:
            place, speed = state
            pace = np.ones(2)
            if self.over == "time":
                pace[0] += share * ((half[k] - first) / (last - first) - 0.5)
            damping = 2.0 * self.zetas * self.omegas * pace * speed
            stiffness = (self.omegas * pace) ** 2
            if self.over == "swing":  # a frequency that changes by the share at an amplitude of 10 mm
                stiffness[0] *= 1.0 + share * 8.0 / 3.0 * (place[0] / 0.01) ** 2
            return np.array([speed, -damping - stiffness * place - acceleration[k]])

        states = np.zeros((len(half) // 2 + 1, 2, 2))
        for n in range(len(states) - 1):
            now, h, k = states[n], self.step_s, 2 * n
            one = slope(k, now)
            two = slope(k + 1, now + 0.5 * h * one)
            three = slope(k + 1, now + 0.5 * h * two)
            four = slope(k + 2, now + h * three)
            states[n + 1] = now + h / 6.0 * (one + 2.0 * two + 2.0 * three + four)
        return states[:, 0]


class ChangingModesCase:
    """What an identification says of two modes, the first of which may change.

    Parameters
    ----------
    over : {"time", "swing"} or None
    """

    def __init__(self, over: Literal["time", "swing"] | None) -> None:
        self.modes = ChangingModes(over)

    def run(self, seed: int) -> Outcome:
        """Identify one record."""
        record = self.modes.record(seed)
        start = time.process_time()
        result = identify(record)
        return Outcome(time.process_time() - start, figures=self._figures(result, self.modes.share(seed)))

    def _figures(self, result: IdentificationResult, share: float) -> dict[str, float]:
        model = result.model
        found = [own for own in result.frequency_changes if own.mode == 0 and own.over == self.modes.over]
        figures = {
            "found": float(bool(found)),
            "false": float(len(result.frequency_changes) - len(found)),
            "modes": float(model.n_modes),
        }
        if model.n_modes != 2:
            return figures
        values = np.concatenate([model.natural_frequencies, model.damping_ratios])
        truth = np.concatenate([self.modes.omegas, self.modes.zetas])
        scores = (values - truth) / np.sqrt(np.diag(model.covariance)[:4])
        # Over the swing the model's frequency is that in between, and what is known is that of rest.
        which = [1, 3] if self.modes.over == "swing" else [0, 1, 2, 3]
        figures |= {f"z{k}": float(scores[k]) for k in which}
        if found and self.modes.over == "time":
            figures["z4"] = (found[0].share - share) / found[0].share_sd
        if found and self.modes.over == "swing":
            figures["rest"] = found[0].from_hz / 3.1 - 1.0
        return figures

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return how often a change was found, or one that is not there, and how often intervals hold [%]."""
        figures = [own.figures for own in outcomes]
        scores = np.array([value for own in figures for key, value in own.items() if key[0] == "z"])
        rest = [abs(own["rest"]) for own in figures if "rest" in own]
        return {
            "found [%]": 100.0 * float(np.mean([own["found"] for own in figures])),
            "false [%]": 100.0 * float(np.mean([own["false"] > 0.0 for own in figures])),
            "two modes [%]": 100.0 * float(np.mean([own["modes"] == 2.0 for own in figures])),
            "coverage [%]": 100.0 * float(np.mean(np.abs(scores) < 1.96)),
            "rms z": float(np.sqrt(np.mean(np.square(scores)))),
            **({"at rest, median off [ppm]": 1e6 * float(np.median(rest))} if rest else {}),
            "time [s]": float(np.median([own.seconds for own in outcomes])),
        }


_TITLES: dict[Literal["time", "swing"] | None, str] = {
    "time": "a mode that changes over time",
    "swing": "a mode that changes over its swing",
    None: "steady modes",
}
STUDIES = {
    f"changing-{over or 'none'}": Study(title, 200, partial(ChangingModesCase, over))
    for over, title in _TITLES.items()
}
