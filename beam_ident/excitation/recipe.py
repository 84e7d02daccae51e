"""What a recipe is: a signal as a few exact numbers, checked, and written down without loss.

Every recipe is a frozen dataclass of plain numbers, with a seed where it needs one: seconds, metres, and hertz for
frequencies.  Kinds and fields are the words of the rig file's ``excitation`` too.  A recipe
describes a displacement ``x(t)`` that is zero before and after.  It is sampled to accelerations
that are held (ZOH) over a period T,

    v[k] = (x(t_k + T/2) - x(t_k - T/2)) / T,      a[k] = (v[k+1] - v[k]) / T

so that both sums telescope: however the recipe looks, the exact integration of the held
accelerations ends with zero velocity and zero displacement, and nothing drifts.  The half-tick
differences attenuate a frequency f by sinc(f T)^2 (1.5 % at 67 Hz for T = 1 ms); the *sampled*
excitation is the truth that the estimators use.

Recipes that are made of levels (``excitation.levels``) may be designed in another
quantity instead; what they hold is brought home in its own way.
"""

from __future__ import annotations

import dataclasses
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.errors import ExcitationError, ModelFormatError
from beam_ident.excitation.sampled import AxisLimits, HeldInput, SampledExcitation

RECIPES: dict[str, type[Recipe]] = {}
"""Every kind of recipe by the name under which it is stored."""

_SCHEMA = 2
_MAX_SAMPLES = 50_000_000


@dataclass(frozen=True)
class Recipe(ABC):
    """Base of all recipes: a signal in time, and how to write it down.

    Raises
    ------
    ExcitationError
        A field is not a finite number, not a whole number, or outside its limits.
    """

    kind: ClassVar[str]

    def __init_subclass__(cls) -> None:
        if "kind" in cls.__dict__:
            RECIPES[cls.kind] = cls

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = self._plain(field.name, str(field.type), getattr(self, field.name))
            object.__setattr__(self, field.name, value)
        self._check()

    @abstractmethod
    def _check(self) -> None:
        """Raise ExcitationError when the numbers make no signal."""

    @property
    @abstractmethod
    def total_s(self) -> float:
        """Length [s], the still stretch at the end included."""

    @abstractmethod
    def displacement(self, times_s: FloatArray) -> FloatArray:
        """Return the displacement [m] at any times [s], zero outside the recipe."""

    def line_spacing_hz(self, near_hz: float) -> float:
        """Return the spacing of the frequencies that this signal resolves around one of them [Hz]."""
        del near_hz  # the same everywhere, but for signals made of chosen frequencies
        return 1.0 / self.total_s

    def sample(self, period_s: float = 1e-3, limits: AxisLimits | None = None) -> SampledExcitation:
        """Sample to accelerations held over a period, checked against limits.

        Raises
        ------
        ExcitationError
            A period that is not positive or too long for the recipe.
        ExcitationLimitError
            The axis cannot follow.
        """
        excitation = SampledExcitation(self, period_s, self._accelerations(period_s))
        if limits is not None:
            excitation.check(limits)
        return excitation

    def sample_input(
        self, period_s: float = 1e-3, scale: float = 1.0, unit: str = "N", name: str = "input"
    ) -> HeldInput:
        """Sample to a held input of another kind: a force, a voltage.

        Parameters
        ----------
        period_s : float -- period of the hold [s]
        scale : float
            What one m/s^2 of the recipe becomes: the mass moved [kg] for a force.  For a recipe that
            was designed as a force, a factor on its amplitude.
        unit, name : str -- of the input

        Notes
        -----
        What is held is the recipe's acceleration times the scale, so that a force moves a free
        hub without leaving it a velocity or a displacement.
        """
        self._require(math.isfinite(scale) and scale != 0.0, "scale", scale, "a number, not 0")
        return HeldInput(self, period_s, scale * self._held_values(period_s), unit, name)

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as plain numbers, enough to rebuild it exactly."""
        content = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in dataclasses.asdict(self).items()
        }
        return {"schema": _SCHEMA, "kind": self.kind, **content}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Recipe:
        """Rebuild a recipe written by ``to_dict``.

        Raises
        ------
        ModelFormatError
            An unknown kind, schema or field.
        ExcitationError
            Numbers that make no signal.
        """
        if not isinstance(data, Mapping):
            raise ModelFormatError(
                f"a {type(data).__name__} is not a stored recipe; expected the mapping that to_dict() returns"
            )
        content = dict(data)
        schema, kind = content.pop("schema", None), content.pop("kind", None)
        if schema != _SCHEMA:
            raise ModelFormatError(f"excitation recipe: schema is {schema!r}; this version reads {_SCHEMA}")
        if not isinstance(kind, str) or kind not in RECIPES:
            raise ModelFormatError(
                f"excitation recipe: kind is {kind!r}; expected one of {', '.join(RECIPES)}"
            )
        known = {f.name for f in dataclasses.fields(RECIPES[kind])}
        unknown = sorted(set(content) - known)
        if unknown:
            raise ModelFormatError(
                f"{kind} recipe: unknown field {unknown[0]!r}; expected {', '.join(sorted(known))}"
            )
        try:
            return RECIPES[kind](**content)
        except TypeError as err:
            raise ModelFormatError(f"{kind} recipe: {err}") from err

    def _ticks(self, period_s: float) -> FloatArray:
        """Return the ticks from one before the start to one after the end [s]."""
        if not (math.isfinite(period_s) and 0.0 < period_s < self.total_s / 4.0):
            raise ExcitationError(
                f"{type(self).__name__}: period_s is {period_s}; expected between 0 and a quarter of the "
                f"{self.total_s} s"
            )
        if self.total_s / period_s > _MAX_SAMPLES:
            raise ExcitationError(
                f"{type(self).__name__}: period_s is {period_s}, which makes {self.total_s / period_s:.3g} "
                f"samples; expected at most {_MAX_SAMPLES:.0e}; give times in seconds"
            )
        n = round(self.total_s / period_s) + 2
        # Half a tick late, so that the first difference is still at rest.
        return np.asarray(np.arange(-1, n + 1) * period_s, dtype=np.float64)

    def _accelerations(self, period_s: float) -> FloatArray:
        """Return the accelerations held over each period [m/s^2]."""
        velocities = np.diff(self.displacement(self._ticks(period_s))) / period_s
        return np.asarray(np.diff(velocities) / period_s)

    def _held_values(self, period_s: float) -> FloatArray:
        """Return what ``sample_input`` scales."""
        return self._accelerations(period_s)

    # Checks of single fields, for the recipes' own _check.

    def _require(self, is_fine: bool, name: str, value: object, expected: str) -> None:
        if not is_fine:
            raise ExcitationError(f"{type(self).__name__}: {name} is {value!r}; expected {expected}")

    def _positive(self, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            self._require(value is None or value > 0, name, value, "a number > 0")

    def _not_negative(self, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            self._require(value >= 0, name, value, "a number >= 0")

    def _not_zero(self, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            self._require(value != 0, name, value, "a number, not 0")

    def _one_of(self, name: str, choices: tuple[str, ...]) -> None:
        value = getattr(self, name)
        self._require(value in choices, name, value, f"one of {', '.join(choices)}")

    def _plain(self, name: str, annotation: str, value: Any) -> Any:
        """Return a field in Python's own type, so that it is written and compared exactly."""
        if annotation == "bool":
            self._require(isinstance(value, (bool, np.bool_)), name, value, "True or False")
            return bool(value)
        if annotation == "int":
            self._require(not isinstance(value, (bool, np.bool_)), name, value, "a whole number")
            try:
                return operator.index(value)
            except TypeError:
                self._require(False, name, value, "a whole number")
        if annotation == "tuple[float, ...]":
            is_list = isinstance(value, (list, tuple, np.ndarray))
            self._require(is_list, name, value, "a list of numbers")
            return tuple(self._number(name, item) for item in value)
        if annotation == "float | None" and value is None:
            return None
        if annotation.startswith("float"):
            return self._number(name, value)
        self._require(isinstance(value, str), name, value, "a word")
        return value

    def _number(self, name: str, value: Any) -> float:
        is_number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        self._require(is_number and math.isfinite(value), name, value, "a finite number")
        return float(value)


def describe_recipe(data: Mapping[str, Any]) -> str:
    """Return a stored recipe in one line for people; long lists are counted, not printed."""
    words = []
    for key, value in data.items():
        if key == "schema":
            continue
        is_long = isinstance(value, (list, tuple)) and len(value) > 8
        words.append(f"{key} ({len(value)} numbers)" if is_long else f"{key} {value}")
    return ", ".join(words)
