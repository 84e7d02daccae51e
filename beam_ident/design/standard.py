"""The best chirp and the best multisine of the usual kinds under the same limits: what a design has to beat.

Kind, direction, band, the share of the length that is still, and the shape of the level (flat in acceleration, in
velocity or in displacement) are searched; the level is always the largest that the limits allow.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from beam_ident.excitation.multisine import Multisine
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.sweeps import LinearChirp, LogChirp

_LEVELS = ("acceleration", "max_velocity", "max_displacement")
_FREE = 1e6  # a ceiling that never binds
_WAYS = (0.8, 0.9, 1.1, 1.25)  # by which the ends of the band are moved
_ROUNDS = 2


def _shapes() -> Iterator[dict[str, Any]]:
    yield {"acceleration": 1.0, "max_velocity": 0.0, "max_displacement": _FREE}
    yield {"acceleration": _FREE, "max_velocity": 1e-2, "max_displacement": _FREE}
    yield {"acceleration": _FREE, "max_velocity": 0.0, "max_displacement": 1e-4}


def louder(recipe: Recipe, factor: float) -> Recipe:
    """Return a sweep or multisine with every level multiplied by a factor."""
    return replace(recipe, **{name: factor * getattr(recipe, name) for name in _LEVELS})


def _chirps(low: float, high: float, duration_s: float, shares: Sequence[float]) -> Iterator[Recipe]:
    for shape, share in itertools.product(_shapes(), shares):
        active = round(share * duration_s, 3)
        common: dict[str, Any] = {
            **shape,
            "duration": active,
            "still": round(duration_s - active, 6),
            "fade_in": min(1.0, active / 8),
            "fade_out": min(0.25, active / 8),
        }
        yield LogChirp(low, high, **common)
        yield LinearChirp(low, high, **common)
        yield LinearChirp(high, low, **common)


def _multisines(low: float, high: float, duration_s: float, shares: Sequence[float]) -> Iterator[Recipe]:
    for shape, share in itertools.product(_shapes(), shares):
        active = round(share * duration_s, 3)
        yield Multisine(
            low,
            high,
            line_period=active,
            n_periods=1,
            still=round(duration_s - active, 6),
            fade=min(0.5, active / 8),
            phases="schroeder",
            **shape,
        )


def best_standard(
    kind: str,
    band_hz: tuple[float, float],
    modes_hz: tuple[float, float],
    duration_s: float,
    shares: Sequence[float],
    value: Callable[[Recipe], tuple[float, Recipe]],
) -> tuple[float, Recipe]:
    """Return the smallest value that a usual excitation reaches, and its recipe at its level.

    Parameters
    ----------
    kind : {"chirp", "multisine"}
    band_hz : tuple of float -- that may be excited [Hz]
    modes_hz : tuple of float -- lowest and highest frequency of the modes [Hz]
    duration_s : float -- of excitation and still stretch together [s]
    shares : sequence of float -- of the length, during which something moves
    value : callable -- the criterion of a recipe at its largest level, and that recipe
    """
    make = _chirps if kind == "chirp" else _multisines
    near = max(band_hz[0], 0.8 * modes_hz[0]), min(band_hz[1], 1.2 * modes_hz[1])
    bands = dict.fromkeys((band_hz, near))
    tried = [value(recipe) for low, high in bands for recipe in make(low, high, duration_s, shares)]
    best = min(tried, key=lambda own: own[0])
    for _ in range(_ROUNDS):
        moved = [
            value(replace(best[1], **{end: getattr(best[1], end) * way}))
            for end, way in itertools.product(("start_frequency", "end_frequency"), _WAYS)
            if _is_inside(best[1], end, way, band_hz)
        ]
        best = min([best, *moved], key=lambda own: own[0])
    return best


def _is_inside(recipe: Any, end: str, way: float, band_hz: tuple[float, float]) -> bool:
    other = {"start_frequency": "end_frequency", "end_frequency": "start_frequency"}[end]
    moved, kept = way * getattr(recipe, end), getattr(recipe, other)
    is_upwards = recipe.start_frequency < recipe.end_frequency
    low, high = (moved, kept) if (end == "start_frequency") == is_upwards else (kept, moved)
    return bool(band_hz[0] <= low and high <= band_hz[1] and high > 1.1 * low)
