"""The best linear approximation from bags: every bag is one realisation of a multisine, as its recipe says.

The recipe gives period and lines, and the command as a reference: what comes back through the hub, from the beam or
around its servo, is then no part of the response.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from beam_ident import BestLinearApproximation, InputSignal, Multisine, best_linear_approximation
from beam_ident.excitation.recipe import Recipe
from beam_ros.errors import UsageError

if TYPE_CHECKING:
    from beam_ros.offline.loading.experiment import Experiment

_REFERENCE = "command"
_SAME_RATE = 1e-3  # two clocks that differ by more do not count the same ticks
_REMEDY = (
    "record a multisine with random phases several times, with other seeds (-p excitation.kind:=multisine -p "
    "excitation.lines:=random_odd -p excitation.seed:=1, 2 ..)"
)


def best_linear_of(experiments: Sequence[Experiment]) -> BestLinearApproximation:
    """Estimate response, noise and nonlinear distortion from bags of one multisine with other seeds.

    Parameters
    ----------
    experiments : sequence of Experiment -- each with the recipe of its excitation

    Raises
    ------
    UsageError
        A bag without a multisine, or multisines of other periods.
    EstimationError
        What ``best_linear_approximation`` refuses.
    """
    recipes = [_recipe(one) for one in experiments]
    periods = sorted({recipe.line_period for recipe in recipes})
    if len(periods) > 1:
        raise UsageError(
            f"the bags hold multisines of the periods {', '.join(f'{own:g}' for own in periods)} s; expected one: "
            f"{_REMEDY}"
        )
    records, windows, scales = [], [], []
    for one, recipe in zip(experiments, recipes, strict=True):
        drive = one.record.inputs[0]
        tick = int(one.info["period_ns"]) * 1e-9
        step = drive.period_s or tick
        # What the hub counts in ticks of its own lasts as long as those do on the host's clock.
        scale = step / tick if abs(step / tick - 1.0) < _SAME_RATE else 1.0
        start = (int(one.info["start_ns"]) - one.record.start_ns) * 1e-9
        command = recipe.displacement(np.asarray((drive.times_s - start) / scale))
        reference = InputSignal(_REFERENCE, "m", drive.times_s, command, "cubic")
        records.append(replace(one.record, inputs=(drive, reference), name=one.path.name))
        begin, end = recipe.steady_window_s
        windows.append((start + scale * begin, start + scale * end))
        scales.append(scale)
    return best_linear_approximation(
        records,
        float(np.mean(scales)) * periods[0],
        [recipe.lines_hz / float(np.mean(scales)) for recipe in recipes],
        windows,
        input_name=records[0].inputs[0].name,
        reference_name=_REFERENCE,
    )


def _recipe(experiment: Experiment) -> Multisine:
    """Return the multisine that a bag's excitation was."""
    info = experiment.info
    recipe = Recipe.from_dict(info["recipe"]) if "recipe" in info else None
    if not isinstance(recipe, Multisine) or not {"start_ns", "period_ns"} <= info.keys():
        said = "does not say what its excitation was" if recipe is None else f"holds a {recipe.kind}"
        raise UsageError(
            f"{experiment.path}: a best linear approximation needs multisines, and it {said}; {_REMEDY}"
        )
    return recipe
