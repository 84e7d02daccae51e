"""From the rig's ``excitation`` parameters to a recipe: the one table of the kinds of excitation.

A kind is a recipe of ``beam_ident``, under the recipe's own name. It reads the parameters that are named as the
recipe's fields are, and what else its row says; the others are left alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from beam_ident.errors import IdentificationError
from beam_ident.excitation import (
    BandLimitedNoise,
    Doublet,
    LinearChirp,
    LogChirp,
    Multisine,
    PointToPoint,
    Prbs,
    Pulse,
    Recipe,
    ShapedMove,
    ShapedMultisine,
    Sine,
    Step,
    SteppedSine,
    Trajectory,
    describe_recipe,
)
from beam_ros.errors import UsageError
from beam_ros.excitation.trajectory_file import read_trajectory
from beam_ros.interfaces.rig_parameters import ExcitationSettings
from beam_ros.rig.rig import Rig

_USUAL_LINE_PERIOD_S = 10.0
_LEVEL_OF_DRIVE = {"acceleration": "acceleration", "velocity": "speed", "position": "step_size"}


def _fades(excitation: ExcitationSettings) -> dict[str, Any]:
    return {
        "fade_in": min(1.0, excitation.duration / 4),
        "fade_out": min(0.25, excitation.duration / 4),
    }


def _fade(excitation: ExcitationSettings) -> dict[str, Any]:
    return {"fade": min(0.5, excitation.duration / 4)}


def _periods(excitation: ExcitationSettings) -> dict[str, Any]:
    duration, period = excitation.duration, excitation.line_period
    n_periods = max(1, round(duration / (period or _USUAL_LINE_PERIOD_S)))
    return {"n_periods": n_periods, "line_period": period or duration / n_periods, **_fade(excitation)}


def _level(excitation: ExcitationSettings) -> dict[str, Any]:
    return {"amplitude": getattr(excitation, _LEVEL_OF_DRIVE[excitation.drive])}


def _sequence(excitation: ExcitationSettings) -> dict[str, Any]:
    clocks = (2 if excitation.inverse_repeat else 1) * (2**excitation.order - 1)
    n_periods = max(1, round(excitation.duration / (clocks * excitation.clock_period)))
    return {"n_periods": n_periods, **_level(excitation)}


def _fade_cycles(excitation: ExcitationSettings) -> dict[str, Any]:
    return {"fade_cycles": min(4.0, excitation.duration * excitation.start_frequency / 4)}


def _nothing(_excitation: ExcitationSettings) -> dict[str, Any]:
    return {}


@dataclass(frozen=True)
class ExcitationKind:
    """A word that ``excitation.kind`` may be.

    Attributes
    ----------
    recipe : type -- its fields are the parameters that are read
    more : callable -- makes the fields that are no parameters, or are not taken as they are
    also_reads : tuple of str -- parameters that ``more`` reads besides
    is_band : bool -- excites a band up to ``end_frequency``
    """

    recipe: type[Recipe]
    more: Callable[[ExcitationSettings], dict[str, Any]] = _nothing
    also_reads: tuple[str, ...] = ()
    is_band: bool = False

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the parameters in ``excitation.`` that the kind reads, in the table's order."""
        wanted = {field.name for field in fields(self.recipe)} | set(self.also_reads)
        return tuple(field.name for field in fields(ExcitationSettings) if field.name in wanted)

    def build(self, excitation: ExcitationSettings) -> Recipe:
        """Make the recipe."""
        taken = {field.name for field in fields(self.recipe)} & set(self.reads)
        return self.recipe(**{name: getattr(excitation, name) for name in taken} | self.more(excitation))


_LEVELS = tuple(_LEVEL_OF_DRIVE.values())

KINDS: dict[str, ExcitationKind] = {
    kind.recipe.kind: kind
    for kind in (
        ExcitationKind(LogChirp, _fades, is_band=True),
        ExcitationKind(LinearChirp, _fades, is_band=True),
        ExcitationKind(Multisine, _periods, ("duration",), is_band=True),
        ExcitationKind(BandLimitedNoise, _fade, is_band=True),
        ExcitationKind(Prbs, _sequence, ("duration", *_LEVELS)),
        ExcitationKind(Pulse, _level, _LEVELS),
        ExcitationKind(Doublet, _level, _LEVELS),
        ExcitationKind(Step),
        ExcitationKind(PointToPoint),
        ExcitationKind(Sine, _fade_cycles),
        ExcitationKind(SteppedSine),
        ExcitationKind(ShapedMultisine, _fade),
        ExcitationKind(Trajectory, read_trajectory, ("file", "file_values", "file_time")),
        ExcitationKind(ShapedMove),
    )
}
"""The kinds of excitation by their name."""


def recipe_of_rig(rig: Rig) -> Recipe:
    """Build the recipe that the rig's ``excitation`` parameters describe.

    Raises
    ------
    UsageError
        The parameters do not make a signal.
    """
    kind = KINDS[rig.excitation.kind]
    highest, nyquist = rig.excitation.end_frequency, 0.5 / rig.hub.period
    if kind.is_band and highest > nyquist:
        raise UsageError(
            f"excitation.end_frequency is {highest:g} Hz: expected at most {nyquist:g} Hz, half the rate "
            "of hub.period"
        )
    try:
        return kind.build(rig.excitation)
    except IdentificationError as err:
        raise UsageError(f"excitation parameters: {err}") from err


def describe_excitation(info: Mapping[str, Any]) -> str:
    """Return an excitation as it is typed after ``-p``: its kind and what that kind reads.

    Parameters
    ----------
    info : mapping -- content of ``excitation/info``; without the rig's parameters, its recipe is described
    """
    excitation = info.get("rig", {}).get("excitation", {})
    kind = KINDS.get(excitation.get("kind"))
    if kind is None:
        return describe_recipe(info.get("recipe", {}))
    names = [name for name in ("kind", *kind.reads) if excitation.get(name, "") != ""]
    return " ".join(f"-p excitation.{name}:={_typed(excitation[name])}" for name in names)


def _typed(value: object) -> str:
    """Return a value as a shell and YAML read it."""
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(_typed, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)
