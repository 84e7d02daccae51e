"""Several models side by side: poles with the significance of their differences, and responses over each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtrc as chi_squared_tail

from beam_ident import figures
from beam_ident.arrays import FloatArray
from beam_ident.errors import ReportError
from beam_ident.evaluation.model_comparison import compare_models
from beam_ident.figures.response_curves import drawing_lines, response_curves
from beam_ident.modal.model import ModalModel
from beam_ident.quantities import nearest_mode, small
from beam_ident.report.evidence import Trial
from beam_ident.report.page import Cell, Page, Tone
from beam_ident.report.validation import add_trials

_TURN = 2.0 * np.pi
_DIFFERENT, _DOUBTFUL = 3.0, 2.0  # |z| of a difference
_BEYOND = 1.3  # times the highest mode


@dataclass(frozen=True)
class ModeDifference:
    """One mode of the first model and of another.

    Attributes
    ----------
    mode : int -- of the first model, counted from 1
    frequency_hz, damping_ratio : float -- second less first
    frequency_z, damping_z : float -- over their combined standard deviation; NaN where none is stated
    """

    mode: int
    frequency_hz: float
    damping_ratio: float
    frequency_z: float
    damping_z: float


@dataclass(frozen=True)
class Difference:
    """A model against the first one.

    Attributes
    ----------
    name : str -- of the model
    modes : tuple of ModeDifference -- that both have
    n_alone : int -- modes that only one of them has
    p_value : float
        How often the same structure would give differences as large as all of these; NaN without standard deviations.
    """

    name: str
    modes: tuple[ModeDifference, ...]
    n_alone: int
    p_value: float


def differences(trials: Sequence[Trial]) -> tuple[Difference, ...]:
    """Weigh every model against the first.

    Parameters
    ----------
    trials : sequence of Trial -- from different records, so that their errors are independent

    Raises
    ------
    ReportError
        Fewer than two, or a model without modes.
    """
    if len(trials) < 2:
        raise ReportError(
            f"{len(trials)} model is given; expected at least two to compare: give another bag or model"
        )
    for trial in trials:
        if not hasattr(trial.model, "modes"):
            raise ReportError(
                f"{trial.name} is a {type(trial.model).__name__}, which has no modes; expected a modal model, a "
                "transfer function or a subspace model: identify its bag with another estimator"
            )
    return tuple(_against(trials[0], trial) for trial in trials[1:])


def _against(first: Trial, second: Trial) -> Difference:
    mine, theirs = first.model.modes(), second.model.modes()
    found = []
    for k, omega in enumerate(mine[0]):
        i = nearest_mode(theirs[0], float(omega))
        if i is None:
            continue
        steps = [float(theirs[part][i] - mine[part][k]) for part in (0, 1)]
        sds = [float(np.hypot(theirs[part][i], mine[part][k])) for part in (2, 3)]
        z = [step / sd if sd > 0.0 else np.nan for step, sd in zip(steps, sds, strict=True)]
        found.append(ModeDifference(k + 1, steps[0] / _TURN, steps[1], z[0], z[1]))
    if isinstance(first.model, ModalModel) and isinstance(second.model, ModalModel):
        p_value = compare_models(first.model, second.model).p_value
    else:
        squares = np.square([(one.frequency_z, one.damping_z) for one in found])
        p_value = float(chi_squared_tail(2 * len(found), np.sum(squares))) if found else np.nan
    alone = len(mine[0]) + len(theirs[0]) - 2 * len(found)
    return Difference(second.name, tuple(found), alone, p_value)


def comparison_page(
    title: str, trials: Sequence[Trial], provenance: Mapping[str, Mapping[str, Any]] | None = None
) -> Page:
    """Build the page that compares models.

    Parameters
    ----------
    title : str
    trials : sequence of Trial -- at least two; the others are compared with the first
    provenance : mapping of mappings, optional

    Raises
    ------
    ReportError
        As ``differences``.
    """
    found = differences(trials)
    page = Page(title, _lead(trials, found))
    page.section("Poles")
    page.figure(
        partial(figures.pole_figure, {trial.name: trial.model.modes() for trial in trials}),
        "Damping ratio over natural frequency of every model, with the 95 % intervals that each states of itself.",
        f"modes of {len(trials)} models by frequency and damping",
        "modes",
    )
    page.section("Differences")
    page.table(
        ["model, mode", "Δf [mHz]", "z of Δf", "Δζ [%]", "z of Δζ"],
        [
            [
                f"{one.name}, {mode.mode}",
                small(1e3 * mode.frequency_hz),
                _judged(mode.frequency_z),
                small(100.0 * mode.damping_ratio),
                _judged(mode.damping_z),
            ]
            for one in found
            for mode in one.modes
        ],
        f"Every model less {trials[0].name}, mode by mode; z is the difference over its combined standard deviation. "
        "Beyond 3 the two are different structures, or one of the deviations leaves something out.",
    )
    for one in found:
        alone = f" {one.n_alone} modes are in one of the two only." if one.n_alone else ""
        chance = (
            f"all differences together come about by chance with p = {one.p_value:.2g}"
            if np.isfinite(one.p_value)
            else "without standard deviations of both nothing can be said of chance"
        )
        page.paragraph(f"{one.name} against {trials[0].name}: {chance}.{alone}")
    page.section("Frequency responses")
    _add_responses(page, trials)
    page.section("Side by side")
    add_trials(page, trials)
    page.provenance(provenance or {})
    return page


def format_comparison(trials: Sequence[Trial], found: Sequence[Difference]) -> str:
    """Return the comparison as a table for a terminal."""
    width = max(len(trial.name) for trial in trials)
    lines = [f"{'':<{width}}  mode   natural frequency [Hz]      z   damping ratio [%]           z"]
    z = {(one.name, mode.mode): mode for one in found for mode in one.modes}
    for number, omega in enumerate(trials[0].model.modes()[0], 1):
        for trial in trials:
            parts = trial.model.modes()
            k = nearest_mode(parts[0], float(omega))
            if k is None:
                lines.append(f"{trial.name:<{width}}  {number:>4}   not in this model")
                continue
            hertz, sd = float(parts[0][k]) / _TURN, float(parts[2][k]) / _TURN
            zeta, zeta_sd = 100.0 * float(parts[1][k]), 100.0 * float(parts[3][k])
            mode = z.get((trial.name, number)) if trial is not trials[0] else None
            lines.append(
                f"{trial.name:<{width}}  {number:>4} {hertz:>12.5f} +- {small(sd):<8} {_z(mode, 'frequency_z')}"
                f" {zeta:>11.5f} +- {small(zeta_sd):<8} {_z(mode, 'damping_z')}"
            )
    return "\n".join(lines)


def _z(mode: ModeDifference | None, name: str) -> str:
    value = np.nan if mode is None else float(getattr(mode, name))
    return f"{value:>+6.1f}" if np.isfinite(value) else f"{'-':>6}"


def _lead(trials: Sequence[Trial], found: Sequence[Difference]) -> str:
    largest = [
        abs(z)
        for one in found
        for mode in one.modes
        for z in (mode.frequency_z, mode.damping_z)
        if np.isfinite(z)
    ]
    names = ", ".join(trial.name for trial in trials)
    if not largest:
        return f"{names}: no mode in common whose uncertainty both state."
    worst = max(largest)
    word = "agree" if worst < _DOUBTFUL else "agree barely" if worst < _DIFFERENT else "differ"
    return f"{names} {word}: the largest difference of a frequency or damping is {worst:.1f} standard deviations."


def _judged(z: float) -> Cell:
    if not np.isfinite(z):
        return Cell("–")
    tone: Tone = "good" if abs(z) < _DOUBTFUL else "doubt" if abs(z) < _DIFFERENT else "bad"
    return Cell(f"{z:+.2f}", tone)


def _add_responses(page: Page, trials: Sequence[Trial]) -> None:
    models = tuple(trial.model for trial in trials)
    every = np.concatenate([model.modes()[0] for model in models])
    lines: FloatArray = drawing_lines(models, 0.1 * float(np.min(every)), _BEYOND * float(np.max(every)))
    curves = [curve for trial in trials for curve in response_curves(trial.model, lines, trial.name)]
    for name in dict.fromkeys(curve.output_name for curve in curves):
        own = [curve for curve in curves if curve.output_name == name]
        page.figure(
            partial(figures.frequency_response_figure, own),
            f"Response of {name} in every model that has it, with 95 % bands where they are known. Where the bands "
            "part, the models contradict each other.",
            f"responses of {name} of {len({curve.label for curve in own})} models over each other",
            f"response-{name}",
        )
