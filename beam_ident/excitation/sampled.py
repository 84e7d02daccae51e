"""Sampled excitations: what an axis or an actuator is given, exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal
from beam_ident.errors import ExcitationError, ExcitationLimitError

if TYPE_CHECKING:
    from beam_ident.excitation.recipe import Recipe

Quantity = Literal["acceleration", "velocity", "position"]

UNITS: dict[str, str] = {"acceleration": "m/s^2", "velocity": "m/s", "position": "m"}

_SAMPLES = {"travel": "positions", "speed": "velocities", "acceleration": "accelerations", "jerk": "jerks"}
_SLIP = 1000.0**0.5  # farther above a limit, it is nearer to a slip of a thousand in the unit than to none

_TOLERANCE = 1e-6  # a peak may touch its limit, with the rounding of the second differences


@dataclass(frozen=True)
class AxisLimits:
    """What the axis may do.

    Parameters
    ----------
    travel : float -- largest distance from the start, either way [m]
    speed : float -- largest speed [m/s]
    acceleration : float -- largest acceleration [m/s^2]
    jerk : float
        Largest change of the acceleration from one period to the next, over the period [m/s^3].
    """

    travel: float = math.inf
    speed: float = math.inf
    acceleration: float = math.inf
    jerk: float = math.inf

    def __post_init__(self) -> None:
        for name in ("travel", "speed", "acceleration", "jerk"):
            value = getattr(self, name)
            if not (isinstance(value, (int, float, np.number)) and value > 0.0):
                raise ExcitationError(f"AxisLimits: {name} is {value!r}; expected a number > 0")


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
    def jerks(self) -> FloatArray:
        """Change of the acceleration at every tick over the period [m/s^3], shape (n + 1,)."""
        return np.asarray(np.diff(self.accelerations, prepend=0.0, append=0.0) / self.period_s)

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
        samples = self.samples(quantity)
        return InputSignal(name, UNITS[quantity], (start_s, self.period_s), samples, hold[quantity])  # type: ignore[arg-type]

    def peaks(self) -> dict[str, tuple[float, str]]:
        """Return peak travel, speed, acceleration and jerk with their units.

        Notes
        -----
        Positions are read at the ticks and at the turning points between them.
        """
        velocities, positions = self.velocities, self.positions
        turning = np.zeros(len(self.accelerations))
        moving = self.accelerations != 0.0
        lag = np.zeros_like(turning)
        lag[moving] = -velocities[:-1][moving] / self.accelerations[moving]
        inside = (lag > 0.0) & (lag < self.period_s)
        turning[inside] = positions[:-1][inside] + 0.5 * velocities[:-1][inside] * lag[inside]
        return {
            "travel": (float(max(np.max(np.abs(positions)), np.max(np.abs(turning)))), "m"),
            "speed": (float(np.max(np.abs(velocities))), "m/s"),
            "acceleration": (float(np.max(np.abs(self.accelerations))), "m/s^2"),
            "jerk": (float(np.max(np.abs(self.jerks))), "m/s^3"),
        }

    def check(self, limits: AxisLimits) -> None:
        """Raise ExcitationLimitError when the axis cannot follow; it names the time from which on."""
        for what, (peak, unit) in self.peaks().items():
            limit = getattr(limits, what)
            if peak > limit:
                beyond = np.abs(getattr(self, _SAMPLES[what])) > limit * (1.0 + _TOLERANCE)
                # Between two ticks, where the hub turns round, no sample is beyond.
                first_s = float(np.argmax(beyond)) * self.period_s if np.any(beyond) else None
                refuse_above(type(self.recipe).__name__, what, peak, limit, unit, first_s)


@dataclass(frozen=True, eq=False)
class HeldInput:
    """A recipe sampled as a held input other than a motion: a force, a voltage.

    Attributes
    ----------
    recipe : Recipe
    period_s : float -- period of the hold [s]
    values : ndarray, shape (n,) -- held from tick k to k + 1, in ``unit``
    unit, name : str
    """

    recipe: Recipe
    period_s: float
    values: FloatArray
    unit: str
    name: str

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.values) * self.period_s

    @property
    def rates(self) -> FloatArray:
        """Change at every tick over the period, in unit/s, shape (n + 1,)."""
        return np.asarray(np.diff(self.values, prepend=0.0, append=0.0) / self.period_s)

    def peaks(self) -> dict[str, tuple[float, str]]:
        """Return the peak value and the peak rate with their units."""
        return {
            "value": (float(np.max(np.abs(self.values))), self.unit),
            "rate": (float(np.max(np.abs(self.rates))), f"{self.unit}/s"),
        }

    def input_signal(self, start_s: float = 0.0) -> InputSignal:
        """Return the input of a record, held between its samples."""
        return InputSignal(self.name, self.unit, (start_s, self.period_s), self.values, "zoh")  # type: ignore[arg-type]

    def check(self, peak: float = math.inf, rate: float = math.inf) -> None:
        """Raise ExcitationLimitError when the actuator cannot follow.

        Parameters
        ----------
        peak : float -- largest value, in ``unit``
        rate : float -- largest change from one period to the next, over the period, in unit/s
        """
        limits = {"value": peak, "rate": rate}
        for what, (seen, unit) in self.peaks().items():
            refuse_above(type(self.recipe).__name__, what, seen, limits[what], unit)


def refuse_above(
    recipe: str, what: str, peak: float, limit: float, unit: str, first_s: float | None = None
) -> None:
    """Raise ExcitationLimitError with the remedy where a peak is above its limit, from an instant on [s]."""
    if peak > limit * (1.0 + _TOLERANCE):
        since = "" if first_s is None else f", first at {first_s:.6g} s"
        slip = "; is it in units a thousand times smaller, as mm for m?" if peak > _SLIP * limit else ""
        raise ExcitationLimitError(
            f"{recipe}: peak {what} {peak:.4g} {unit} is above the limit of {limit:.4g} {unit}{since}; lower the "
            f"amplitude by a factor of {limit / peak:.3g} or change the band{slip}"
        )
