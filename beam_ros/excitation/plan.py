"""From the rig's excitation parameters to the samples for its hub, checked before anything moves.

A plan is refused on the axis's limits and on what the beam is predicted to do: a hub that moves millimetres
bends a resonant tip by centimetres. The hub checks every sequence once more with the same prediction, from
any sender.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from beam_ident.errors import IdentificationError
from beam_ident.excitation import AxisLimits, Recipe, SampledExcitation
from beam_ident.numerics.blas_threads import one_blas_thread
from beam_model import PredictedLoads
from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.gate.sequence_assembly import BLOCK_TICKS, MAX_TICKS
from beam_ros.rig.rig import Rig

_HOLD_OF_MODE = {"acceleration": "zoh", "velocity": "zoh", "position": "linear", "effort": "zoh"}
_PIECES = (BLOCK_TICKS, 512, 16)  # ticks: so near, in three steps, the place is found where a limit is left


@dataclass(frozen=True)
class ExcitationPlan:
    """A checked excitation for one rig.

    Attributes
    ----------
    recipe : Recipe
    sampled : SampledExcitation -- at the device's period
    mode : str -- the hub's command mode
    values : ndarray, shape (n_ticks,) -- samples in the mode's unit
    prediction : PredictedLoads -- what the beam and the hub are predicted to bear
    """

    recipe: Recipe
    sampled: SampledExcitation
    mode: str
    values: FloatArray
    prediction: PredictedLoads

    def info(self, rig: Rig) -> dict[str, Any]:
        """Describe the plan for ``excitation/info``: recipe, seed, hold, and the rig's parameters."""
        return {
            "recipe": self.recipe.to_dict(),
            "mode": self.mode,
            "hold": _HOLD_OF_MODE[self.mode],
            "period_ns": round(self.sampled.period_s * 1e9),
            "samples": len(self.values),
            "predicted_tip_deflection": self.prediction.tip_deflection,
            "rig": rig.to_nested(),
        }


def plan_excitation(rig: Rig) -> ExcitationPlan:
    """Sample the rig's excitation and check it against the hub's limits and the beam's predicted motion.

    Raises
    ------
    UsageError
        The excitation leaves a limit; the message names it and by how much.
    """
    recipe = recipe_of_rig(rig)
    period_s = rig.hub.period
    limits = AxisLimits(
        travel=rig.hub.travel / 2,
        speed=rig.hub.max_speed,
        acceleration=rig.hub.max_acceleration,
        jerk=rig.excitation.max_jerk or math.inf,
    )
    n_ticks = round(recipe.total_s / period_s)
    if n_ticks > MAX_TICKS:
        raise UsageError(
            f"excitation refused: it lasts {recipe.total_s:g} s, {n_ticks} ticks of the hub: at most {MAX_TICKS} "
            f"ticks ({MAX_TICKS * period_s:g} s) are taken; shorten excitation.duration or excitation.still"
        )
    try:
        sampled = recipe.sample(period_s, limits)
    except IdentificationError as err:
        raise UsageError(f"excitation refused: {err}") from err
    mode = rig.hub.command_mode
    mass = rig.beam_parameters().total_mass
    values = sampled.accelerations * mass if mode == "effort" else sampled.samples(mode)
    guard = rig.beam_guard()
    with one_blas_thread():
        loads = guard.sequence()
        reasons = [loads.add(block) for _, block in _blocks(values, 0, BLOCK_TICKS)]
        reason = next(filter(None, reasons), None) or loads.objection()
        if reason:
            first = _first_beyond(guard, values)
            raise UsageError(f"excitation refused: {reason}; the limit is left at {first * period_s:.4g} s")
    return ExcitationPlan(recipe, sampled, mode, values, loads.loads)


def _blocks(values: FloatArray, first: int, n_ticks: int) -> Iterator[tuple[int, FloatArray]]:
    """Yield samples from a tick on in pieces, each with the number of its first tick."""
    for k in range(first, len(values), n_ticks):
        yield k, values[k : k + n_ticks]


def _first_beyond(guard: BeamGuard, values: FloatArray) -> int:
    """Return the tick, to within the last of ``_PIECES``, at which samples first lead beyond a limit of the beam."""
    found, before = 0, len(values)
    for n_ticks in _PIECES:
        loads = guard.sequence()
        for _, block in _blocks(values[:found], 0, BLOCK_TICKS):
            loads.add(block)
        for first, block in _blocks(values[:before], found, n_ticks):
            found = first
            if loads.add(block) or loads.objection():
                break
        before = found + n_ticks
    return found
