"""From the rig's excitation parameters to the samples for its hub, checked before anything moves.

A plan is refused on the axis's limits and on what the beam is predicted to do: a hub that moves millimetres
bends a resonant tip by centimetres. The hub checks every sequence once more with the same prediction, from
any sender.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.errors import IdentificationError
from beam_ident.excitation import AxisLimits, Recipe, SampledExcitation
from beam_model.advice.experiment_advice import PredictedLoads, predict_loads
from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.rig.rig import Rig

_HOLD_OF_MODE = {"acceleration": "zoh", "velocity": "zoh", "position": "linear", "effort": "zoh"}


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
    try:
        sampled = recipe.sample(period_s, limits)
    except IdentificationError as err:
        raise UsageError(f"excitation refused: {err}") from err
    model = rig.beam_model()
    mode = rig.hub.command_mode
    total_mass = model.matrices.M[0, 0]
    is_force = mode == "effort"
    values = sampled.accelerations * total_mass if is_force else sampled.samples(mode)  # type: ignore[arg-type]
    plan = ExcitationPlan(
        recipe,
        sampled,
        mode,
        values,
        predict_loads(model, period_s, sampled.accelerations, rig.beam.thickness),
    )
    reason = _refusal(rig, plan.prediction)
    if reason:
        raise UsageError(f"excitation refused: {reason}")
    return plan


def _refusal(rig: Rig, prediction: PredictedLoads) -> str | None:
    limit, force_limit = rig.hub.max_tip_deflection, rig.hub.max_effort
    if prediction.tip_deflection > limit:
        return (
            f"predicted tip deflection {prediction.tip_deflection * 1e3:.3g} mm: the limit "
            f"hub.max_tip_deflection is {limit * 1e3:g} mm; lower excitation.acceleration to "
            f"{100 * limit / prediction.tip_deflection:.0f} %"
        )
    strain_limit = rig.beam.max_root_strain
    if prediction.root_strain > strain_limit:
        return (
            f"predicted root strain {prediction.root_strain:.3g}: the limit beam.max_root_strain is "
            f"{strain_limit:g}; lower excitation.acceleration to {100 * strain_limit / prediction.root_strain:.0f} %"
        )
    if prediction.hub_force > force_limit:
        return (
            f"predicted hub force {prediction.hub_force:.3g} N: the limit hub.max_effort is "
            f"{force_limit:g} N; lower excitation.acceleration"
        )
    return None


def tip_guard(rig: Rig) -> Callable[[FloatArray], str | None]:
    """Build the hub's own check of a sequence against the predicted motion of the beam.

    Returns
    -------
    callable -- from samples in the command mode's unit, at device ticks, to a reason for refusal or None
    """
    model = rig.beam_model()
    mode, period_s = rig.hub.command_mode, rig.hub.period
    thickness = rig.beam.thickness

    def guard(values: FloatArray) -> str | None:
        if mode == "acceleration":
            accelerations = values
        elif mode == "effort":
            accelerations = values / model.matrices.M[0, 0]
        else:
            order = {"velocity": 1, "position": 2}[mode]
            accelerations = np.diff(values, order, prepend=[values[0]] * order) / period_s**order
        prediction = predict_loads(model, period_s, np.asarray(accelerations, dtype=np.float64), thickness)
        return (
            _refusal(rig, prediction) if math.isfinite(prediction.tip_deflection) else "prediction diverged"
        )

    return guard
