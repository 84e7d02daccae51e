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
from scipy.linalg import expm
from scipy.signal import butter, filtfilt

from beam_ident import AxisResult, InputSignal, OutputSignal, TimeRecord, identify_axis
from beam_ident.arrays import FloatArray
from benchmarks.ident.study import AgainstBound, Outcome, Study, stated_bound

_HALVES = 24  # of a period, until an instant is known


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
    speed_gain, place_gain : float -- of the servo's two loops [1/s], the first in units of the mass
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
    speed_gain: float = 90.0
    place_gain: float = 60.0

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
        state, unknown, last = self._at_rest(), 0.0, 0.0
        memory = math.exp(-h / 0.02)
        for k in range(n):
            y = self._sensed(state) + float(noise[k])
            seen[k] = round(y / self.quantum) * self.quantum if self.quantum else y
            if self.is_closed_loop:
                slope = (float(seen[k]) - last) / h
                error = self.place_gain * (float(reference[k]) - float(seen[k])) + float(wanted[k]) - slope
                force = self.mass * self.speed_gain * error
            else:
                slope = float(wanted[k])
                way = math.copysign(1.0, slope) if slope else 0.0
                turn = float(wanted[min(k + 1, n - 1)] - wanted[k]) / h
                force = self.mass * turn + self.truth[1] * slope + self.truth[2] * way + self.truth[3]
            last = float(seen[k])
            forces[k] = min(max(force, -self.max_force), self.max_force)
            waiting.append(float(forces[k]))
            unknown = memory * unknown + self.disturbance * math.sqrt(1.0 - memory**2) * float(knocks[k])
            state = self._after(h, state, waiting.pop(0) + unknown)
        inputs = (
            InputSignal("force", "N", (0.0, h), forces, "zoh"),
            InputSignal("reference", "m", (0.0, h), reference, "linear"),
        )
        return TimeRecord(inputs, (OutputSignal("position", "m", (0.0, h), seen),), name=f"seed {seed}")

    def _at_rest(self) -> Any:
        return 0.0, 0.0

    def _sensed(self, state: Any) -> float:
        return float(state[0])

    def _after(self, left: float, state: Any, force: float) -> Any:
        """Return position and velocity after a time under a constant force, from event to event."""
        x, v = state
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


@dataclass(frozen=True)
class CompliantAxis(DrivenAxis):
    """An axis whose drive pulls the hub by a spring; friction is the hub's.

    Parameters
    ----------
    drive_mass : float -- part of the mass ahead of the spring [kg]
    stiffness, damping : float -- of the spring [N/m], [N s/m]
    is_of_drive : bool -- whether the encoder sits on the drive, else on the hub
    """

    drive_mass: float = 20.0
    stiffness: float = 1e6
    damping: float = 240.0
    is_of_drive: bool = False
    speed_gain: float = 30.0
    place_gain: float = 20.0

    @cached_property
    def _steps(self) -> dict[int, list[tuple[FloatArray, FloatArray]]]:
        """What the period, its half, its quarter ... do to drive and hub, by the direction of the hub's motion.

        State: place and speed of the drive, place and speed of the hub; inputs: force on the drive, force on the hub.
        """
        found = {}
        k, d = self.stiffness, self.damping
        for way in (1, -1, 0):
            drag = self.viscous[0] if way > 0 else self.viscous[1]
            A = np.zeros((6, 6))
            A[0, 1] = A[2, 3] = 1.0
            A[1, :5] = np.array([-k, -d, k, d, 1.0]) / self.drive_mass
            A[3] = np.array([k, d, -k, -d - drag, 0.0, 1.0]) / (self.mass - self.drive_mass)
            if not way:
                A[2], A[3] = 0.0, 0.0
            halves = [expm(A * self.period_s * 0.5**j) for j in range(_HALVES)]
            found[way] = [(own[:4, :4], own[:4, 4:]) for own in halves]
        return found

    def _at_rest(self) -> Any:
        return np.zeros(4)

    def _sensed(self, state: Any) -> float:
        return float(state[0] if self.is_of_drive else state[2])

    def _after(self, left: float, state: Any, force: float) -> Any:
        """Return the state after the period: an event ends the longest half, quarter ... that it leaves whole."""
        done = 0.0
        while done < 1.0:
            pull = self._pull(state)
            way = int(np.sign(state[3])) or int(pull > self.coulomb[0]) - int(pull < -self.coulomb[1])
            dry = self.coulomb[0] if way > 0 else -self.coulomb[1]
            forces = np.array([force, -self.offset - dry])
            # As long a step as ends on a whole multiple of itself.
            for j in range(next(i for i in range(_HALVES) if (done * 2**i) % 1.0 == 0.0), _HALVES):
                over_state, over_force = self._steps[way][j]
                new = over_state @ state + over_force @ forces
                if way * new[3] >= 0.0 if way else -self.coulomb[1] <= self._pull(new) <= self.coulomb[0]:
                    break
            else:
                new[3] = 0.0
            state, done = new, done + 0.5**j
        return state

    def _pull(self, state: Any) -> float:
        """Return what would move a hub at rest [N]."""
        spring = self.stiffness * (state[0] - state[2]) + self.damping * (state[1] - state[3])
        return float(spring) - self.offset


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


@dataclass
class CompliantDriveCase(AgainstBound):
    """Records of one axis with a compliant drive, whose spring is looked for.

    Parameters
    ----------
    axis : CompliantAxis
    options : dict -- of ``identify_axis``
    """

    axis: CompliantAxis
    options: dict[str, Any]

    def __post_init__(self) -> None:
        own = {"stiffness": self.axis.stiffness, "drive_damping": self.axis.damping}
        if "drive_mass" not in self.options:
            own["drive_mass"] = self.axis.drive_mass
        self.names = ("mass", "viscous", "coulomb", "offset", *own)
        self.truth = np.array([*self.axis.truth, *own.values()])

    @cached_property
    def bound(self) -> FloatArray:  # type: ignore[override]
        """Standard deviations stated for records of the middle."""
        return stated_bound(lambda seed: np.array(self.run(seed).sd), 3)

    def run(self, seed: int) -> Outcome:
        """Identify one record; a drive that is called stiff is a failure."""
        record = self.axis.record(seed)
        start = time.perf_counter()
        found = identify_axis(record, force="force", **self.options)
        seconds = time.perf_counter() - start
        if not found.is_compliant:
            return Outcome(seconds)
        rows = np.array([(found.value(name), found.sd(name)) for name in self.names])
        return Outcome(seconds, rows[:, 0], rows[:, 1])

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the figures of ``AgainstBound``, and the coverage of each parameter."""
        good = [o for o in outcomes if self.is_near(o)]
        inside = [np.abs(o.estimate - self.truth) < 1.96 * o.sd for o in good]
        each = [round(float(c), 3) for c in np.mean(inside, axis=0)]
        return super().summarise(outcomes) | {"coverage of each": dict(zip(self.names, each, strict=True))}


@dataclass
class StiffDriveCase:
    """Records of axes without a spring in the drive, each of another kind, and what is said of one.

    Parameters
    ----------
    axes : tuple of DrivenAxis -- taken in turn
    """

    axes: tuple[DrivenAxis, ...]

    def run(self, seed: int) -> Outcome:
        """Look for a spring with the encoder on the hub and on the drive, the mass of that known and unknown."""
        axis = self.axes[seed % len(self.axes)]
        record = axis.record(seed)
        share = 0.2 * axis.mass
        start = time.perf_counter()
        found = [
            identify_axis(record, force="force", **options)
            for options in (
                {"drive_mass": share},
                {"encoder": "drive", "drive_mass": share},
                {"encoder": "drive"},
            )
        ]
        seconds = time.perf_counter() - start
        names = ("hub", "drive", "drive of unknown mass")
        return Outcome(
            seconds / 3.0,
            figures={
                name: -1.0 if one.is_compliant else one.stiffer_than
                for name, one in zip(names, found, strict=True)
            },
        )

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return how often the drive was called stiff, and the middle of the limits that were stated."""
        rows = np.array([list(o.figures.values()) for o in outcomes])
        names = list(outcomes[0].figures)
        return {
            "called stiff": dict(zip(names, np.mean(~(rows < 0.0), axis=0).round(3).tolist(), strict=True)),
            "median limit N/m": {
                name: f"{value:.2g}" for name, value in zip(names, np.nanmedian(rows, axis=0), strict=True)
            },
        }


_FAST = {"duration_s": 8.0, "speed": 0.2}
_STIFF = (
    DrivenAxis(**_FAST),
    DrivenAxis(**_FAST, delay_steps=3),
    DrivenAxis(**_FAST, noise=1e-6, quantum=1e-5),
    DrivenAxis(**_FAST, coulomb=(30.0, 15.0), viscous=(150.0, 250.0)),
    DrivenAxis(**_FAST, static=15.0),
    DrivenAxis(**_FAST, disturbance=1.0),
)

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
    "axis-compliant-drive": Study(
        "axis with a drive on a spring of 40 Hz, encoder on the drive",
        200,
        lambda: CompliantDriveCase(CompliantAxis(**_FAST, is_of_drive=True), {"encoder": "drive"}),
    ),
    "axis-compliant-drive-seen-from-hub": Study(
        "axis with a drive on a spring of 40 Hz, encoder on the hub",
        200,
        lambda: CompliantDriveCase(
            CompliantAxis(**_FAST, speed_gain=8.0, place_gain=6.0), {"drive_mass": 20.0}
        ),
    ),
    "axis-stiff-drive": Study(
        "axes without a spring: delay, coarse encoder, friction by direction, stiction, unmeasured forces",
        120,
        lambda: StiffDriveCase(_STIFF),
    ),
}
