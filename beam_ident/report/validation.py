"""Validation on unseen data, linearity over levels, and repeatability from record to record."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from beam_ident import figures
from beam_ident.errors import EstimationError
from beam_ident.evaluation.repeatability import assess_repeatability
from beam_ident.modal.model import ModalModel
from beam_ident.quantities import nearest_mode, small, with_uncertainty
from beam_ident.report.evidence import Trial, Unseen
from beam_ident.report.page import Cell, Page, Tone

TONES: dict[str, Tone] = {"good": "good", "noise-limited": "good", "fair": "doubt", "poor": "bad"}


def add_validation(page: Page, unseen: Sequence[Unseen]) -> None:
    """Add how the model predicts records that it has not seen."""
    if not unseen:
        page.warning(
            "The model was not tried on data that it has not seen.",
            "Record the experiment again, better with another excitation, and give it as the record to validate on.",
            tone="doubt",
        )
        return
    for one in unseen:
        page.subsection(f"On {one.name}")
        rows: list[list[str | Cell]] = []
        for validation in one.results:
            for o in validation.outputs:
                word = o.verdict.partition(" ")[0]
                rows.append(
                    [
                        o.name,
                        Cell(word, TONES.get(word, "")),
                        f"{o.simulation_scores.fit_percent:.2f}",
                        f"{o.scores.fit_percent:.2f}",
                        f"{o.deflection_scores.fit_percent:.2f}",
                        small(o.noise_ratio),
                        "white" if o.whiteness.is_white else f"not white (p = {o.whiteness.p_value:.2g})",
                        "independent" if o.input_correlation.is_independent else "still holds the input",
                    ]
                )
        page.table(
            [
                "output",
                "verdict",
                "FIT from rest [%]",
                "FIT [%]",
                "FIT of deflection [%]",
                "residual / noise",
                "residual in time",
                "residual and input",
            ],
            rows,
            "Prediction of unseen data. From rest: the plain simulation, for which only offset and drift are fitted. "
            "The other scores also fit the motion that was already there when the record began. Residual over noise "
            "is near 1 where the model leaves nothing but noise.",
        )


def add_predictions(page: Page, unseen: Sequence[Unseen]) -> None:
    """Draw every prediction of unseen data, with the correlation of its residual with the input."""
    for one in unseen:
        for validation in one.results:
            names = ", ".join(o.name for o in validation.outputs)
            page.figure(
                partial(figures.validation_figure, validation),
                "Measurement and prediction of unseen data, as a plain simulation and with fitted initial motion, "
                "and the correlation of residual and input: bars outside the band are dynamics that it lacks.",
                f"prediction of {names} on {one.name}, with the residual's correlation with the input",
                f"validation-{_stem(one.name)}-{_stem(names)}",
            )


def add_trials(page: Page, trials: Sequence[Trial]) -> None:
    """Add the records one by one: linearity over their levels, and whether they scatter as much as stated."""
    page.table(
        [
            "mode",
            *(f"{trial.name}: f [Hz]" for trial in trials),
            *(f"{trial.name}: ζ [%]" for trial in trials),
        ],
        _side_by_side(trials),
        "Every record identified by itself: natural frequencies and damping ratios with their standard deviations.",
    )
    modal = [trial.model for trial in trials if isinstance(trial.model, ModalModel)]
    if len(modal) == len(trials):
        try:
            page.paragraph(f"Repeatability: {assess_repeatability(modal).verdict}.")
        except EstimationError as err:
            page.paragraph(f"Repeatability was not judged: {err}.")
    levels = np.array([trial.amplitude for trial in trials])
    by_level = bool(np.all(np.isfinite(levels)))
    abscissas = 1e3 * levels if by_level else 1.0 + np.arange(len(trials))
    found = _trend(trials, abscissas)
    if not found:
        return
    page.figure(
        partial(
            figures.trend_figure,
            found,
            [trial.name for trial in trials],
            "largest deflection of the record [mm]" if by_level else "record",
        ),
        "Frequency and damping of every mode, record by record, with 95 % intervals: level where the structure is "
        "linear. A damping that rises with the amplitude, or a frequency that falls, is a property of the structure "
        "and not of the estimate.",
        f"frequency and damping of {len(found)} modes in {len(trials)} records",
        "linearity",
    )
    for name, (x, hertz, hertz_sd, zeta, zeta_sd) in found.items():
        if by_level and np.ptp(x) > 0.05 * np.max(np.abs(x)):
            page.paragraph(
                f"{name}: {_slope(x, hertz, hertz_sd)} Hz per mm, damping {_slope(x, 100 * zeta, 100 * zeta_sd)} % "
                "per mm."
            )


def _side_by_side(trials: Sequence[Trial]) -> list[list[str]]:
    first = trials[0].model.modes()
    rows = []
    for number, omega in enumerate(first[0], 1):
        hertz, damping = [], []
        for trial in trials:
            omegas, zetas, omega_sd, zeta_sd = trial.model.modes()
            k = nearest_mode(omegas, float(omega))
            if k is None:
                hertz.append("–")
                damping.append("–")
                continue
            turn = 2.0 * np.pi
            hertz.append(with_uncertainty(float(omegas[k]) / turn, float(omega_sd[k]) / turn))
            damping.append(with_uncertainty(100.0 * float(zetas[k]), 100.0 * float(zeta_sd[k])))
        rows.append([str(number), *hertz, *damping])
    return rows


def _trend(trials: Sequence[Trial], abscissas: Any) -> dict[str, tuple[Any, ...]]:
    found = {}
    for number, omega in enumerate(trials[0].model.modes()[0], 1):
        columns = np.full((len(trials), 4), np.nan)
        for row, trial in enumerate(trials):
            numbers = trial.model.modes()
            k = nearest_mode(numbers[0], float(omega))
            if k is not None:
                columns[row] = [float(part[k]) for part in numbers]
        turn = 2.0 * np.pi
        found[f"mode {number}"] = (
            abscissas,
            columns[:, 0] / turn,
            columns[:, 2] / turn,
            columns[:, 1],
            columns[:, 3],
        )
    return found


def _slope(x: Any, values: Any, sds: Any) -> str:
    """Return the slope of a line through values with standard deviations."""
    seen = np.isfinite(values) & np.isfinite(sds) & (sds > 0.0)
    if np.count_nonzero(seen) < 2:
        return "–"
    weights = 1.0 / sds[seen] ** 2
    centre = np.average(x[seen], weights=weights)
    spread = float(np.sum(weights * (x[seen] - centre) ** 2))
    slope = float(np.sum(weights * (x[seen] - centre) * values[seen])) / spread
    return with_uncertainty(slope, 1.0 / np.sqrt(spread))


def _stem(name: str) -> str:
    return "".join(sign if sign.isalnum() else "-" for sign in name).strip("-")
