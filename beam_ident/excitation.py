"""Excitations as exact recipes: what the hub is told to do, known to the last digit.

A recipe describes a displacement ``x(t)`` that is zero before and after.  It is sampled
to accelerations that are held (ZOH) over a period T,

    v[k] = (x(t_k + T/2) - x(t_k - T/2)) / T,      a[k] = (v[k+1] - v[k]) / T

so that both sums telescope: however the recipe looks, the exact integration of the
held accelerations ends with zero velocity and zero displacement, and nothing drifts.
The half-tick differences attenuate a frequency f by sinc(f T)^2 (1.5 % at 67 Hz for
T = 1 ms); the *sampled* excitation is the truth that the estimators use.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from beam_ident.errors import ExcitationError, ExcitationLimitError, ModelFormatError
from beam_ident.piecewise import FloatArray
from beam_ident.records import InputSignal

Quantity = Literal["acceleration", "velocity", "position"]

_SCHEMA = 1


def _smooth_rise(fraction: FloatArray) -> FloatArray:
    """Return the septic 0 -> 1 whose first three derivatives vanish at both ends."""
    s = np.clip(fraction, 0.0, 1.0)
    return np.asarray(s**4 * (35.0 - s * (84.0 - s * (70.0 - 20.0 * s))))


def _window(times: FloatArray, duration_s: float, fade_in_s: float, fade_out_s: float) -> FloatArray:
    rise = _smooth_rise(times / fade_in_s)
    fall = _smooth_rise((duration_s - times) / fade_out_s)
    return np.asarray(rise * fall)


def _require(is_fine: bool, recipe: str, name: str, value: object, expected: str) -> None:
    if not is_fine:
        raise ExcitationError(f"{recipe}: {name} is {value!r}; expected {expected}")


@dataclass(frozen=True)
class AxisLimits:
    """What the axis may do.

    Parameters
    ----------
    travel : float -- largest distance from the start, either way [m]
    speed : float -- largest speed [m/s]
    acceleration : float -- largest acceleration [m/s^2]
    """

    travel: float = math.inf
    speed: float = math.inf
    acceleration: float = math.inf


@dataclass(frozen=True, eq=False)
class SampledExcitation:
    """A recipe sampled for an axis: accelerations held over each period.

    Attributes
    ----------
    recipe : Recipe
    period_s : float -- period of the hold [s]
    accelerations : ndarray, shape (n,) -- held from tick k to k + 1 [m/s^2]
    velocities, positions : ndarray, shape (n + 1,)
        The exact integral of the held accelerations at the ticks [m/s], [m].
    """

    recipe: Recipe
    period_s: float
    accelerations: FloatArray

    @property
    def velocities(self) -> FloatArray:
        """Velocity at every tick [m/s], shape (n + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.accelerations) * self.period_s])

    @property
    def positions(self) -> FloatArray:
        """Displacement at every tick [m], shape (n + 1,)."""
        velocities = self.velocities
        return np.concatenate([[0.0], np.cumsum(0.5 * (velocities[:-1] + velocities[1:])) * self.period_s])

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.accelerations) * self.period_s

    def samples(self, quantity: Quantity) -> FloatArray:
        """Return the command in the quantity that an axis takes."""
        if quantity == "acceleration":
            return self.accelerations
        if quantity == "velocity":
            return self.velocities
        if quantity == "position":
            return self.positions
        raise ExcitationError(f"quantity is {quantity!r}; expected acceleration, velocity or position")

    def input_signal(
        self, quantity: Quantity = "acceleration", name: str = "hub", start_s: float = 0.0
    ) -> InputSignal:
        """Return the excitation as the input of a record.

        Notes
        -----
        Held accelerations make straight velocities (exact) and piecewise quadratic
        positions, which the cubic spline through the ticks follows to 1e-3 of the
        distance between two ticks.
        """
        hold: dict[str, Any] = {"acceleration": "zoh", "velocity": "linear", "position": "cubic"}
        unit = {"acceleration": "m/s^2", "velocity": "m/s", "position": "m"}
        samples = self.samples(quantity)
        return InputSignal(name, unit[quantity], (start_s, self.period_s), samples, hold[quantity])  # type: ignore[arg-type]

    def check(self, limits: AxisLimits) -> None:
        """Raise ExcitationLimitError when the axis cannot follow.

        Notes
        -----
        Positions are checked at the ticks and at the turning points between them.
        """
        velocities, positions = self.velocities, self.positions
        turning = np.zeros(len(self.accelerations))
        moving = self.accelerations != 0.0
        lag = np.zeros_like(turning)
        lag[moving] = -velocities[:-1][moving] / self.accelerations[moving]
        inside = (lag > 0.0) & (lag < self.period_s)
        turning[inside] = positions[:-1][inside] + 0.5 * velocities[:-1][inside] * lag[inside]
        peaks = {
            "travel": (max(np.max(np.abs(positions)), np.max(np.abs(turning))), limits.travel, "m"),
            "speed": (np.max(np.abs(velocities)), limits.speed, "m/s"),
            "acceleration": (np.max(np.abs(self.accelerations)), limits.acceleration, "m/s^2"),
        }
        for what, (peak, limit, unit) in peaks.items():
            if peak > limit * (1.0 + 1e-9):
                raise ExcitationLimitError(
                    f"{type(self.recipe).__name__}: peak {what} {peak:.4g} {unit} is above the limit of "
                    f"{limit:.4g} "
                    f"{unit}; lower the amplitude by a factor of {limit / peak:.3f} or change the band"
                )


@dataclass(frozen=True)
class Recipe(ABC):
    """Base of all recipes: a displacement in time, and how to write it down."""

    kind: ClassVar[str]

    @property
    @abstractmethod
    def duration_s(self) -> float:
        """Length [s], the still stretch at the end included."""

    @abstractmethod
    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s], zero outside the recipe."""

    def sample(self, period_s: float = 1e-3, limits: AxisLimits | None = None) -> SampledExcitation:
        """Sample to accelerations held over a period, checked against limits.

        Raises
        ------
        ExcitationError
            A period that is not positive or too long for the recipe.
        ExcitationLimitError
            The axis cannot follow.
        """
        if not (math.isfinite(period_s) and 0.0 < period_s < self.duration_s / 4.0):
            raise ExcitationError(
                f"{type(self).__name__}: period_s is {period_s}; expected between 0 and a quarter of the "
                f"{self.duration_s} s"
            )
        n = round(self.duration_s / period_s) + 2
        # Half a tick late, so that the first difference is still at rest.
        ticks = np.asarray(np.arange(-1, n + 1) * period_s, dtype=np.float64)
        displacement = self.displacement(ticks)
        velocities = np.diff(displacement) / period_s
        excitation = SampledExcitation(self, period_s, np.diff(velocities) / period_s)
        if limits is not None:
            excitation.check(limits)
        return excitation

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as plain numbers, enough to rebuild it exactly."""
        return {"schema": _SCHEMA, "kind": self.kind, **dataclasses.asdict(self)}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Recipe:
        """Rebuild a recipe written by :meth:`to_dict`.

        Raises
        ------
        ModelFormatError
            An unknown kind, schema or field.
        """
        content = dict(data)
        schema, kind = content.pop("schema", None), content.pop("kind", None)
        if schema != _SCHEMA:
            raise ModelFormatError(f"excitation recipe: schema is {schema!r}; this version reads {_SCHEMA}")
        if kind not in RECIPES:
            raise ModelFormatError(
                f"excitation recipe: kind is {kind!r}; expected one of {', '.join(RECIPES)}"
            )
        known = {f.name for f in dataclasses.fields(RECIPES[kind])}
        unknown = sorted(set(content) - known)
        if unknown:
            raise ModelFormatError(
                f"{kind} recipe: unknown field {unknown[0]!r}; expected {', '.join(sorted(known))}"
            )
        return RECIPES[kind](**content)


def _soft_minimum(first: FloatArray | float, second: FloatArray) -> FloatArray:
    """Return a smooth function just below the smaller of two positive ones."""
    return np.asarray((np.power(first, -8.0) + np.power(second, -8.0)) ** -0.125)


@dataclass(frozen=True)
class LogChirp(Recipe):
    """Logarithmic chirp of constant acceleration under a ceiling of displacement.

    Parameters
    ----------
    start_hz, end_hz : float -- first and last frequency [Hz]
    sweep_s : float -- length of the sweep [s]
    acceleration : float -- amplitude of the acceleration [m/s^2]
    displacement_ceiling : float -- largest amplitude of the displacement [m]
    still_s : float -- stretch of a still hub after the sweep [s]
    fade_in_s, fade_out_s : float -- smooth ramps at both ends of the sweep [s]

    Notes
    -----
    ``alpha0(f) = min(ceiling, acceleration / (2 pi f)^2)``, the corner rounded; phase
    ``2 pi f0 L (e^(t/L) - 1)`` with ``L = sweep / ln(f1/f0)``.
    """

    kind: ClassVar[str] = "log_chirp"

    start_hz: float = 1.0
    end_hz: float = 95.0
    sweep_s: float = 20.0
    acceleration: float = 0.7
    displacement_ceiling: float = 0.005
    still_s: float = 10.0
    fade_in_s: float = 1.0
    fade_out_s: float = 0.25

    def __post_init__(self) -> None:
        name = type(self).__name__
        for field_name in ("start_hz", "end_hz", "sweep_s", "acceleration", "displacement_ceiling"):
            value = getattr(self, field_name)
            _require(math.isfinite(value) and value > 0.0, name, field_name, value, "a number > 0")
        _require(
            self.end_hz > self.start_hz, name, "end_hz", self.end_hz, f"above start_hz = {self.start_hz}"
        )
        _require(
            math.isfinite(self.still_s) and self.still_s >= 0.0,
            name,
            "still_s",
            self.still_s,
            "a number >= 0",
        )
        for field_name in ("fade_in_s", "fade_out_s"):
            value = getattr(self, field_name)
            _require(
                0.0 < value <= self.sweep_s / 2, name, field_name, value, "between 0 and half of sweep_s"
            )

    @property
    def duration_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.sweep_s + self.still_s

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        times = np.clip(times_s, 0.0, self.sweep_s)
        growth = self.sweep_s / math.log(self.end_hz / self.start_hz)
        frequency = self.start_hz * np.exp(times / growth)
        phase = 2.0 * np.pi * growth * (frequency - self.start_hz)
        amplitude = _soft_minimum(
            self.displacement_ceiling, self.acceleration / (2.0 * np.pi * frequency) ** 2
        )
        window = _window(times, self.sweep_s, self.fade_in_s, self.fade_out_s)
        return np.asarray(window * amplitude * np.sin(phase))


@dataclass(frozen=True)
class Multisine(Recipe):
    """Random-phase multisine on the lines of a period, flat in acceleration.

    Parameters
    ----------
    low_hz, high_hz : float -- band [Hz]; the lines are multiples of 1 / ``line_period_s``
    line_period_s : float -- period of the signal [s]
    n_periods : int -- how often it repeats
    rms_acceleration : float -- root mean square of the acceleration [m/s^2]
    displacement_ceiling : float
        Largest amplitude of one line's displacement [m], for the low ones.
    odd_only : bool -- keep odd lines only, so that even distortion shows on the others
    seed : int -- seed of the phases
    still_s : float -- stretch of a still hub afterwards [s]
    fade_s : float -- smooth ramps at both ends [s]
    """

    kind: ClassVar[str] = "multisine"

    low_hz: float = 1.0
    high_hz: float = 95.0
    line_period_s: float = 10.0
    n_periods: int = 2
    rms_acceleration: float = 0.5
    displacement_ceiling: float = 0.001
    odd_only: bool = False
    seed: int = 0
    still_s: float = 10.0
    fade_s: float = 0.5

    def __post_init__(self) -> None:
        name = type(self).__name__
        for field_name in (
            "low_hz",
            "high_hz",
            "line_period_s",
            "rms_acceleration",
            "displacement_ceiling",
            "fade_s",
        ):
            value = getattr(self, field_name)
            _require(math.isfinite(value) and value > 0.0, name, field_name, value, "a number > 0")
        _require(self.n_periods >= 1, name, "n_periods", self.n_periods, "at least 1")
        _require(self.seed >= 0, name, "seed", self.seed, "an integer >= 0")
        _require(
            math.isfinite(self.still_s) and self.still_s >= 0.0,
            name,
            "still_s",
            self.still_s,
            "a number >= 0",
        )
        _require(
            self.fade_s <= self.active_s / 2,
            name,
            "fade_s",
            self.fade_s,
            "at most half of all periods together",
        )
        _require(len(self.lines_hz) > 0, name, "high_hz", self.high_hz, "a band with at least one line in it")

    @property
    def active_s(self) -> float:
        """Length of all periods together [s]."""
        return self.n_periods * self.line_period_s

    @property
    def duration_s(self) -> float:
        """Length [s], the still stretch included."""
        return self.active_s + self.still_s

    @property
    def lines_hz(self) -> FloatArray:
        """Frequencies of the lines [Hz]."""
        first = max(math.ceil(self.low_hz * self.line_period_s - 1e-9), 1)
        last = math.floor(self.high_hz * self.line_period_s + 1e-9)
        numbers = np.arange(first, last + 1)
        if self.odd_only:
            numbers = numbers[numbers % 2 == 1]
        return np.asarray(numbers / self.line_period_s)

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        omega = 2.0 * np.pi * self.lines_hz
        phases = np.random.default_rng(self.seed).uniform(0.0, 2.0 * np.pi, len(omega))
        per_line = self.rms_acceleration * math.sqrt(2.0 / len(omega))
        amplitudes = _soft_minimum(self.displacement_ceiling, per_line / omega**2)
        times = np.clip(times_s, 0.0, self.active_s)
        total = np.zeros_like(times)
        for amplitude, rate, phase in zip(amplitudes, omega, phases, strict=True):
            total += amplitude * np.sin(rate * times + phase)
        return np.asarray(_window(times, self.active_s, self.fade_s, self.fade_s) * total)


@dataclass(frozen=True)
class Step(Recipe):
    """Smooth move to a distance, a rest there, and the same way back.

    Parameters
    ----------
    distance : float -- how far [m], either sign
    rise_s : float -- length of the move [s]
    hold_s : float -- rest at the far end [s]
    still_s : float -- rest at home afterwards [s]
    """

    kind: ClassVar[str] = "step"

    distance: float = 0.005
    rise_s: float = 0.2
    hold_s: float = 10.0
    still_s: float = 10.0

    def __post_init__(self) -> None:
        name = type(self).__name__
        _require(
            math.isfinite(self.distance) and self.distance != 0.0,
            name,
            "distance",
            self.distance,
            "a number, not 0",
        )
        _require(
            math.isfinite(self.rise_s) and self.rise_s > 0.0, name, "rise_s", self.rise_s, "a number > 0"
        )
        for field_name in ("hold_s", "still_s"):
            value = getattr(self, field_name)
            _require(math.isfinite(value) and value >= 0.0, name, field_name, value, "a number >= 0")

    @property
    def duration_s(self) -> float:
        """Length [s], both rests included."""
        return 2.0 * self.rise_s + self.hold_s + self.still_s

    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s]."""
        out = _smooth_rise(np.asarray(times_s) / self.rise_s)
        back = _smooth_rise((np.asarray(times_s) - self.rise_s - self.hold_s) / self.rise_s)
        return np.asarray(self.distance * (out - back))


RECIPES: dict[str, type[Recipe]] = {cls.kind: cls for cls in (LogChirp, Multisine, Step)}
