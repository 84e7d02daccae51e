"""The modal table with its uncertainty budget, the mode shapes, and theory beside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from beam_ident import figures
from beam_ident.arrays import FloatArray
from beam_ident.figures.response_curves import response_curves
from beam_ident.modal.model import ModalModel
from beam_ident.report.evidence import ErrorSources, ModeRow, Theory
from beam_ident.report.page import Page
from beam_ident.report.quantities import decimals, interval, nearest_mode, small, with_uncertainty
from beam_ident.transfer_function.model import TransferFunctionModel

_TURN = 2.0 * np.pi


class Budget(NamedTuple):
    """Standard uncertainties of one number, source by source; they add up in squares.

    Attributes
    ----------
    statistics : float -- from the scatter of the samples
    clock : float -- from what the fit does not know of the rate of one clock against the other
    time_base : float -- from the clock that all stamps rest on
    temperature : float -- NaN where nothing is said of it
    """

    statistics: float
    clock: float
    time_base: float = 0.0
    temperature: float = np.nan

    @property
    def together(self) -> float:
        """Combined standard uncertainty."""
        return float(np.sqrt(np.nansum(np.square(self)))) if np.isfinite(self.statistics) else np.nan


def budget_of(mode: ModeRow, sources: ErrorSources) -> tuple[Budget, Budget]:
    """Return the budgets of a mode's natural frequency [rad/s] and of its damping ratio.

    Notes
    -----
    What the clock rate contributes is the part of the variance that goes with it: its covariance with the number,
    squared, over its own variance.
    """
    share = [0.0, 0.0]
    if isinstance(mode.model, ModalModel):
        n = mode.model.n_modes
        covariance, rate = mode.model.covariance, 2 * n + 1
        places = (mode.number - 1, n + mode.number - 1)
        if covariance[rate, rate] > 0.0:
            share = [float(covariance[place, rate] ** 2 / covariance[rate, rate]) for place in places]
    own = [max(sd**2 - part, 0.0) for sd, part in zip((mode.omega_sd, mode.zeta_sd), share, strict=True)]
    kelvin = sources.temperature_k
    of_temperature = np.nan if kelvin is None else abs(sources.frequency_per_kelvin) * kelvin * mode.omega
    return (
        Budget(
            float(np.sqrt(own[0])), float(np.sqrt(share[0])), sources.time_base * mode.omega, of_temperature
        ),
        Budget(float(np.sqrt(own[1])), float(np.sqrt(share[1]))),
    )


def add_modes(
    page: Page, modes: Sequence[ModeRow], sources: ErrorSources, doubts: Sequence[str] = ()
) -> None:
    """Add the table of modes with 95 % intervals, and the budgets apart and together."""
    rows, frequency_rows, damping_rows = [], [], []
    for k, mode in enumerate(modes):
        of_omega, of_zeta = budget_of(mode, sources)
        hertz, hertz_sd = mode.omega / _TURN, of_omega.together / _TURN
        zeta, zeta_sd = 100.0 * mode.zeta, 100.0 * of_zeta.together
        doubt = doubts[k] if k < len(doubts) else ""
        rows.append(
            [
                mode.name,
                with_uncertainty(hertz, hertz_sd),
                interval(hertz, hertz_sd),
                with_uncertainty(zeta, zeta_sd),
                interval(zeta, zeta_sd),
                doubt or "none",
            ]
        )
        frequency_rows.append(
            [
                mode.name,
                f"{hertz:.{decimals(hertz_sd, 3)}f}",
                *(small(1e3 * part / _TURN) for part in of_omega),
                small(1e3 * hertz_sd),
            ]
        )
        damping_rows.append(
            [
                mode.name,
                f"{zeta:.{decimals(zeta_sd, 3)}f}",
                small(100.0 * of_zeta.statistics),
                small(100.0 * of_zeta.clock),
                small(zeta_sd),
            ]
        )
    page.table(
        ["mode", "f [Hz]", "95 % interval [Hz]", "ζ [%]", "95 % interval [%]", "doubt"],
        rows,
        "The modes, with all known sources of uncertainty together. A damping ratio holds at the amplitude of this "
        "experiment only.",
    )
    page.table(
        [
            "mode",
            "f [Hz]",
            "statistics [mHz]",
            "clock [mHz]",
            "time base [mHz]",
            "temperature [mHz]",
            "together [mHz]",
        ],
        frequency_rows,
        "Uncertainty budget of the natural frequencies, standard uncertainties apart and together. Statistics: the "
        "scatter of the samples; clock: what the fit does not know of the clocks' rates; time base: the clock "
        "that all stamps rest on; temperature: a dash where nothing is said of it.",
    )
    page.table(
        ["mode", "ζ [%]", "statistics [%]", "clock [%]", "together [%]"],
        damping_rows,
        "Uncertainty budget of the damping ratios, standard uncertainties. Scale, marker heights and time base do "
        "not enter them.",
    )


def add_poles(
    page: Page,
    models: Sequence[Any],
    modes: Sequence[ModeRow],
    reference: Sequence[tuple[str, float, float]] | None,
) -> None:
    """Add damping over frequency, and the map of poles and zeros."""
    if modes:
        page.figure(
            figures.pole_figure(modes_by_output(modes), reference),
            "Damping ratio over natural frequency. The bars are 95 % intervals from the scatter of the samples; the "
            "budget above has the other sources.",
            f"{len(modes)} modes by frequency and damping",
            "modes",
        )
    for model in models:
        if not isinstance(model, ModalModel | TransferFunctionModel) or not len(model.poles):
            continue
        name = getattr(model, "output_name", "")
        page.figure(
            figures.pole_zero_figure(model),
            f"Poles and zeros of the upper half plane{f', {name}' if name else ''}, with the ellipses in which the "
            "poles lie at 95 %; small panels look at each pole closely. Zeros far beyond the poles stand for what "
            "the model leaves out, and are not drawn.",
            f"map of the poles and zeros{f' of {name}' if name else ''}",
            f"poles-{name}" if name else "poles",
        )


def modes_by_output(
    modes: Sequence[ModeRow],
) -> dict[str, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return the modes of every output, or of all together, as ``modes()`` of a model gives them."""
    names = dict.fromkeys(mode.output for mode in modes)
    found = {}
    for name in names:
        own = [mode for mode in modes if mode.output == name]
        columns = np.array([[m.omega, m.zeta, m.omega_sd, m.zeta_sd] for m in own]).T
        found[name or "identified, 95 %"] = (columns[0], columns[1], columns[2], columns[3])
    return found


def add_shapes(page: Page, model: Any, theory: Theory | None, sources: ErrorSources) -> None:
    """Add residues and amplitudes at the poles, output by output, and the shapes over the markers."""
    if not isinstance(model, ModalModel):
        _add_amplitudes(page, model)
        return
    for path in model.paths:
        _add_residues(page, path, theory, sources)
    if theory is not None and len(theory.heights) and not model.further_inputs:
        _add_shape_figure(page, model, theory, sources)


def _add_residues(page: Page, model: ModalModel, theory: Theory | None, sources: ErrorSources) -> None:
    of_drive = f", driven by {model.input_name}"
    if model.has_body_under_force:
        masses = zip(model.output_names, model.rigid_body_mass, model.rigid_body_mass_sd, strict=True)
        page.table(
            ["output", "mass [kg]", "95 % interval [kg]"],
            [[name, with_uncertainty(m, sd), interval(m, sd)] for name, m, sd in masses],
            f"The mass that moves as a rigid body{of_drive}, as every output sees it (1 over its gain, in kg where "
            "the force is in N and the output in m): outputs on one body that does not turn see one mass.",
        )
    if not model.n_modes:
        return
    sizes = {curve.output_name: curve for curve in response_curves(model, model.natural_frequencies)}
    rows = []
    for i in range(model.n_modes):
        k = (
            None
            if theory is None
            else nearest_mode(theory.natural_frequencies, float(model.natural_frequencies[i]))
        )
        for j, name in enumerate(model.output_names):
            value, statistics = float(model.residues[j, i]), float(model.residue_sd[j, i])
            of_scale = abs(value) * sources.scale.get(name, np.nan)
            of_height, expected = np.nan, np.nan
            if theory is not None and k is not None and name in theory.residues:
                expected = float(theory.residues[name][k])
                of_height = float(theory.residue_sd[name][k])
            together = float(np.sqrt(np.nansum(np.square([statistics, of_scale, of_height]))))
            curve = sizes[name]
            rows.append(
                [
                    f"{i + 1}, {name}",
                    with_uncertainty(value, together),
                    small(statistics),
                    small(of_scale),
                    small(of_height),
                    small(together),
                    f"{expected:.4g}" if np.isfinite(expected) else "–",
                    f"{(value - expected) / together:+.1f}"
                    if np.isfinite(expected) and together > 0.0
                    else "–",
                    with_uncertainty(float(abs(curve.response[i])), float(curve.magnitude_sd[i])),
                ]
            )
    page.table(
        [
            "mode, output",
            "residue r",
            "statistics",
            "scale",
            "marker height",
            "together",
            "theory",
            "z",
            "|H| at ω",
        ],
        rows,
        f"Shape and amplitude at the poles{of_drive}: the residue of every mode at every output with its standard "
        "uncertainties, the residue of theory, their difference over the combined uncertainty, and the size of the "
        "whole response at the natural frequency.",
    )


def _add_amplitudes(page: Page, model: Any) -> None:
    if not hasattr(model, "modes"):
        return
    omegas = np.asarray(model.modes()[0])
    rows = [
        [
            f"{curve.output_name} over {curve.input_name}, mode {i + 1}",
            with_uncertainty(float(abs(curve.response[i])), float(curve.magnitude_sd[i])),
            f"{np.degrees(np.angle(curve.response[i])):.1f}",
        ]
        for curve in response_curves(model, omegas)
        for i in range(len(omegas))
    ]
    if rows:
        page.table(
            ["path", "|H| at ω", "phase [deg]"],
            rows,
            "Size and phase of the response at the natural frequencies.",
        )


def _add_shape_figure(page: Page, model: ModalModel, theory: Theory, sources: ErrorSources) -> None:
    pairs = [
        (i, k)
        for i in range(model.n_modes)
        if (k := nearest_mode(theory.natural_frequencies, float(model.natural_frequencies[i]))) is not None
    ]
    places = [j for j, name in enumerate(model.output_names) if name in theory.places]
    if not pairs or not places:
        return
    heights = np.array([theory.places[model.output_names[j]] for j in places])
    scale = np.array([sources.scale.get(model.output_names[j], 0.0) for j in places])
    own = [i for i, _ in pairs]
    residues = model.residues[np.ix_(places, own)]
    sd = np.hypot(model.residue_sd[np.ix_(places, own)], np.abs(residues) * np.nan_to_num(scale)[:, None])
    page.figure(
        figures.mode_shape_figure(
            [f"mode {i + 1}" for i in own],
            theory.heights,
            theory.shapes[:, [k for _, k in pairs]],
            heights[:, 0],
            heights[:, 1],
            residues,
            sd,
        ),
        "Mode shapes: the residues of theory along the beam, and over them the identified ones at the markers, with "
        "95 % intervals of both residue and height. Nothing is scaled to fit: a wrong scale, height or mass shows.",
        f"shapes of {len(pairs)} modes with the markers on them",
        "shapes",
    )


def add_theory(page: Page, modes: Sequence[ModeRow], theory: Theory, sources: ErrorSources) -> None:
    """Add identified frequencies beside theory's, through the budget of theory."""
    page.paragraph(theory.source)
    rows, parts = [], []
    for mode in modes:
        k = nearest_mode(theory.natural_frequencies, mode.omega)
        if k is None:
            rows.append([mode.name, f"{mode.omega / _TURN:.4f}", *(["–"] * 7)])
            continue
        own = budget_of(mode, sources)[0].together / mode.omega
        deviation = mode.omega / theory.predicted[k] - 1.0
        combined = float(np.hypot(np.nan_to_num(own), theory.type_b[k]))
        zeta_z = (mode.zeta - theory.damping_ratios[k]) / mode.zeta_sd if mode.zeta_sd > 0.0 else np.nan
        rows.append(
            [
                f"{mode.name} ({k + 1})",
                f"{mode.omega / _TURN:.4f}",
                f"{theory.natural_frequencies[k] / _TURN:.4f}",
                f"{theory.predicted[k] / _TURN:.4f}",
                f"{100 * deviation:+.3f}",
                small(100 * combined),
                f"{deviation / combined:+.2f}" if combined > 0.0 else "–",
                f"{100 * theory.damping_ratios[k]:.4g}",
                f"{zeta_z:+.2f}" if np.isfinite(zeta_z) else "–",
            ]
        )
        parts.append(
            [
                f"{k + 1}",
                *(f"{100 * own_part[k]:+.3f}" for own_part in theory.contributions.values()),
                f"{100 * theory.type_b[k]:.3f}",
            ]
        )
    page.table(
        [
            "mode (of theory)",
            "identified f [Hz]",
            "ideal [Hz]",
            "predicted [Hz]",
            "deviation [%]",
            "uncertainty [%]",
            "z",
            "theory ζ [%]",
            "z of ζ",
        ],
        rows,
        "Identified modes beside theory. Predicted: the ideal less what a real clamp and the air that moves along "
        "take. z is the deviation over its combined standard uncertainty; that of the damping counts the statistical "
        "part alone, since theory takes damping as given.",
    )
    if parts:
        page.table(
            ["mode", *(f"{name} [%]" for name in theory.contributions), "together [%]"],
            parts,
            "The budget of theory: standard uncertainty of every predicted frequency from each source, of type B. "
            "One source moves all modes together.",
        )
    if np.isfinite(theory.chi_squared):
        page.paragraph(
            f"All compared modes together, with the correlations that the common sources make: chi-squared "
            f"{theory.chi_squared:.2f} over {len(parts)} modes; near their number means that theory and experiment "
            "agree within their uncertainties. Far above it the pattern over the modes fits no mixture of the named "
            "sources: something acts that the budget lacks, or a stated shift is not there, as with a simulated beam."
        )
