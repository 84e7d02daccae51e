"""A prismatic axis behind a servo, with friction: mass and friction from its force and its noisy position.

The axis is stepped from event to event in closed form by code of its own. Beside ``identify_axis`` stands what is
usual: least squares on derivatives of the filtered position.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.signal import butter, filtfilt

from beam_ident import AxisResult, InputSignal, OutputSignal, TimeRecord, identify_axis
from beam_ident.arrays import FloatArray
from benchmarks.ident.study import AgainstBound, Outcome, Study, stated_bound

_SPEED_GAIN = 90.0  # 1/s, of the servo's loop of speed, in units of the mass
_PLACE_GAIN = 60.0  # 1/s


@dataclass(frozen=True)
class DrivenAxis:
    """A mass on a guide, its servo, and what its sensors say.

    Parameters
    ----------
    mass : float -- [kg]
    viscous, coulomb : (forward, backward) -- friction [N s/m], [N]
    offset : float -- constant force that pulls backward [N]
    delay_steps : int -- samples by which the force acts late
    noise : float -- of the position [m], standard deviation
    quantum : float -- step of the encoder [m]; 0: none
    disturbance : float -- standard deviation of a force that nobody measures, with a memory of 20 ms [N]
    max_force : float -- saturation [N]
    static : float -- by how much breaking loose takes more than sliding [N]
    is_closed_loop : bool -- whether a servo follows the moves, or their force is simply fed forward
    duration_s, period_s : float
    stroke, speed : float -- of the longest of the moves [m], and how fast the typical one is [m/s]
    """

    mass: float = 95.1
    viscous: tuple[float, float] = (203.5, 203.5)
    coulomb: tuple[float, float] = (20.4, 20.4)
    offset: float = -3.2
    delay_steps: int = 0
    noise: float = 5e-6
    quantum: float = 0.0
    disturbance: float = 0.0
    max_force: float = math.inf
    static: float = 0.0
    is_closed_loop: bool = True
    duration_s: float = 25.0
    period_s: float = 1e-3
    stroke: float = 0.23
    speed: float = 0.1

    @property
    def truth(self) -> FloatArray:
        """Mass, mean viscous and dry friction, and half the difference of the resistances."""
        forward, backward = self.coulomb
        return np.array(
            [
                self.mass,
                0.5 * sum(self.viscous),
                0.5 * (forward + backward),
                self.offset + 0.5 * (forward - backward),
            ]
        )

    def moves(self, rng: np.random.Generator) -> FloatArray:
        """Return a reference of moves of random length and speed, forward and backward, with short rests [m]."""
        n = round(self.duration_s / self.period_s)
        parts: list[FloatArray] = []
        here, done, forward = 0.0, 0, True
        while done < n:
            there = self.stroke * (0.4 + 0.6 * rng.random()) if forward else 0.0
            seconds = max(1.5 * abs(there - here) / (self.speed * (0.5 + rng.random())), 0.3)
            s = np.arange(1, round(seconds / self.period_s) + 1) * self.period_s / seconds
            parts.append(here + (there - here) * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5))
            if not forward:
                parts.append(np.full(round(0.3 / self.period_s), there))
            done += sum(map(len, parts[-2:])) if not forward else len(parts[-1])
            here, forward = there, not forward
        return np.concatenate(parts)[:n]

    def record(self, seed: int) -> TimeRecord:
        """Return force, reference and position of one seed."""
        rng = np.random.default_rng(seed)
        h = self.period_s
        reference = self.moves(rng)
        wanted = np.gradient(reference, h)
        n = len(reference)
        noise = self.noise * rng.standard_normal(n)
        knocks = rng.standard_normal(n)
        forces, seen = np.empty(n), np.empty(n)
        waiting = [0.0] * self.delay_steps
        x, v, unknown, last = 0.0, 0.0, 0.0, 0.0
        memory = math.exp(-h / 0.02)
        for k in range(n):
            y = x + float(noise[k])
            seen[k] = round(y / self.quantum) * self.quantum if self.quantum else y
            if self.is_closed_loop:
                slope = (float(seen[k]) - last) / h
                error = _PLACE_GAIN * (float(reference[k]) - float(seen[k])) + float(wanted[k]) - slope
                force = self.mass * _SPEED_GAIN * error
            else:
                slope = float(wanted[k])
                way = math.copysign(1.0, slope) if slope else 0.0
                turn = float(wanted[min(k + 1, n - 1)] - wanted[k]) / h
                force = self.mass * turn + self.truth[1] * slope + self.truth[2] * way + self.truth[3]
            last = float(seen[k])
            forces[k] = min(max(force, -self.max_force), self.max_force)
            waiting.append(float(forces[k]))
            unknown = memory * unknown + self.disturbance * math.sqrt(1.0 - memory**2) * float(knocks[k])
            x, v = self._after(h, x, v, waiting.pop(0) + unknown)
        inputs = (
            InputSignal("force", "N", (0.0, h), forces, "zoh"),
            InputSignal("reference", "m", (0.0, h), reference, "linear"),
        )
        return TimeRecord(inputs, (OutputSignal("position", "m", (0.0, h), seen),), name=f"seed {seed}")

    def _after(self, left: float, x: float, v: float, force: float) -> tuple[float, float]:
        """Return position and velocity after a time under a constant force, from event to event."""
        for _ in range(20):
            if v == 0.0:
                if force - self.offset > self.coulomb[0] + self.static:
                    way = 1
                elif force - self.offset < -self.coulomb[1] - self.static:
                    way = -1
                else:
                    return x, 0.0
            else:
                way = 1 if v > 0.0 else -1
            dry, drag = (self.coulomb[0], self.viscous[0]) if way > 0 else (-self.coulomb[1], self.viscous[1])
            rate, push = drag / self.mass, (force - self.offset - dry) / self.mass
            if rate < 1e-9:
                stop = -v / push if way * push < 0.0 else math.inf
                spent = min(stop, left)
                x, v = x + v * spent + 0.5 * push * spent**2, v + push * spent
            else:
                final = push / rate
                stop = math.log((final - v) / final) / rate if way * final < 0.0 else math.inf
                spent = min(stop, left)
                gone = math.exp(-rate * spent)
                x, v = x + final * spent + (v - final) * (1.0 - gone) / rate, final + (v - final) * gone
            if spent == left:
                return x, v
            v, left = 0.0, left - spent
        return x, 0.0


def filtered_least_squares(record: TimeRecord, cutoff_hz: float = 50.0) -> FloatArray:
    """Return mass, viscous and dry friction and offset by least squares on derivatives of the filtered position."""
    period = record.inputs[0].period_s or math.nan
    b, a = butter(4, cutoff_hz * 2.0 * period)
    position = filtfilt(b, a, record.outputs[0].values)
    # A held force acts half a step later than its stamp, on average.
    f = record.inputs[0].values
    force = filtfilt(b, a, 0.5 * (f + np.concatenate([f[:1], f[:-1]])))
    velocity = np.gradient(position, period)
    columns = np.stack([np.gradient(velocity, period), velocity, np.sign(velocity), np.ones(len(f))], axis=1)
    inner = slice(200, -200)
    return np.asarray(np.linalg.lstsq(columns[inner], force[inner], rcond=None)[0])


@dataclass
class DrivenAxisCase(AgainstBound):
    """Closed-loop records of one axis, and the two estimates of each.

    Parameters
    ----------
    axis : DrivenAxis
    options : dict -- of ``identify_axis``
    """

    axis: DrivenAxis = field(default_factory=DrivenAxis)
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.truth = self.axis.truth

    @cached_property
    def bound(self) -> FloatArray:  # type: ignore[override]
        """Standard deviations stated for records of the middle."""
        return stated_bound(lambda seed: self.estimate(seed).standard_deviations[:4], 3)

    def estimate(self, seed: int) -> AxisResult:
        """Identify one record."""
        return identify_axis(self.axis.record(seed), force="force", **self.options)

    def run(self, seed: int) -> Outcome:
        """Identify one record by both ways."""
        record = self.axis.record(seed)
        start = time.perf_counter()
        found = identify_axis(record, force="force", **self.options)
        seconds = time.perf_counter() - start
        plain = dict(zip(("mass", "viscous", "dry", "offset"), filtered_least_squares(record), strict=True))
        return Outcome(seconds, found.estimates[:4], found.standard_deviations[:4], plain)

    def is_near(self, outcome: Outcome) -> bool:
        """Return whether a run found the parameters within a tenth."""
        return bool(
            outcome.estimate is not None
            and np.all(np.abs(outcome.estimate - self.truth) <= 0.1 * np.abs(self.truth))
        )

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the figures of ``AgainstBound``, the largest errors, and those of least squares on derivatives."""
        good = [o for o in outcomes if self.is_near(o)]
        own = np.array([o.estimate for o in good]) / self.truth - 1.0
        plain = np.array([list(o.figures.values()) for o in outcomes]) / self.truth - 1.0
        scores = np.abs([(o.estimate - self.truth) / o.sd for o in good])
        return super().summarise(outcomes) | {
            "coverage of each": [round(float(c), 3) for c in np.mean(scores < 1.96, axis=0)],
            "largest error %": [round(100.0 * float(e), 4) for e in np.max(np.abs(own), axis=0)],
            "least squares on derivatives, mean error %": [
                round(100.0 * float(e), 3) for e in np.mean(plain, axis=0)
            ],
        }


STUDIES = {
    "axis-closed-loop": Study("axis behind a servo, 25 s at 1 kHz, 5 um", 200, DrivenAxisCase),
    "axis-noisy-position": Study(
        "axis behind a servo, 50 um", 200, lambda: DrivenAxisCase(DrivenAxis(noise=5e-5))
    ),
    "axis-open-loop": Study(
        "axis under moves fed forward, 5 um", 200, lambda: DrivenAxisCase(DrivenAxis(is_closed_loop=False))
    ),
    "axis-disturbed": Study(
        "axis behind a servo, 2 N of unmeasured force",
        200,
        lambda: DrivenAxisCase(DrivenAxis(disturbance=2.0), {"reference": "reference"}),
    ),
}
