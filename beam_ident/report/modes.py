"""The modal table with its uncertainty budget, the mode shapes, and theory beside them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from beam_ident import figures
from beam_ident.arrays import FloatArray
from beam_ident.figures.response_curves import response_curves
from beam_ident.modal.identification_result import FrequencyChange
from beam_ident.modal.model import ModalModel
from beam_ident.quantities import (
    decimals,
    interval,
    nearest_mode,
    sentence,
    signed,
    small,
    with_uncertainty,
)
from beam_ident.report.evidence import Agreement, ErrorSources, ModeRow, Theory
from beam_ident.report.page import Page
from beam_ident.transfer_function.model import TransferFunctionModel

_TURN = 2.0 * np.pi


def add_modes(
    page: Page,
    modes: Sequence[ModeRow],
    doubts: Sequence[str] = (),
    changes: Sequence[FrequencyChange] = (),
) -> None:
    """Add the table of modes with 95 % intervals, and that of the frequencies that changed meanwhile."""
    if not modes:
        page.paragraph("The outputs follow a rigid body, and no mode stands out of the noise.")
        return
    rows = []
    for k, mode in enumerate(modes):
        of_omega, of_zeta = mode.of_omega, mode.of_zeta
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
    page.table(
        ["mode", "f [Hz]", "95 % interval [Hz]", "ζ [%]", "95 % interval [%]", "doubt"],
        rows,
        "The modes; ± is the standard uncertainty of all known sources together. A damping ratio holds at the "
        "amplitude of this experiment only.",
    )
    if changes:
        page.table(
            ["mode", "over", "from [Hz]", "to [Hz]", "change [%]", "95 % interval [%]"],
            [_changed(modes[own.mode].name, own) for own in changes],
            "Natural frequencies that changed while they were recorded; the table above has the one in between. Over "
            "time: from the first stamp to the last; over the swing: from rest to the largest amplitude.",
        )


def _changed(name: str, own: FrequencyChange) -> list[str]:
    percent, percent_sd = 100.0 * own.share, 100.0 * own.share_sd
    places = decimals(percent_sd * own.from_hz / 100.0)
    return [
        name,
        "time" if own.over == "time" else f"swing of {small(own.swing)}",
        f"{own.from_hz:.{places}f}",
        f"{own.to_hz:.{places}f}",
        with_uncertainty(percent, percent_sd),
        interval(percent, percent_sd),
    ]


def add_budgets(page: Page, modes: Sequence[ModeRow]) -> None:
    """Add the uncertainties of frequencies and damping ratios, apart and together."""
    if not modes:
        return
    frequency_rows, damping_rows = [], []
    for mode in modes:
        of_omega, of_zeta = mode.of_omega, mode.of_zeta
        hertz, hertz_sd = mode.omega / _TURN, of_omega.together / _TURN
        zeta, zeta_sd = 100.0 * mode.zeta, 100.0 * of_zeta.together
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
    sources: ErrorSources,
) -> None:
    """Add damping over frequency, and the map of poles and zeros."""
    if modes:
        page.figure(
            partial(figures.pole_figure, modes_by_output(modes), reference),
            "Damping ratio over natural frequency. The bars are 95 % intervals of all known sources.",
            f"{len(modes)} modes by frequency and damping",
            "modes",
        )
    for model in models:
        if not isinstance(model, ModalModel | TransferFunctionModel) or not len(model.poles):
            continue
        name = getattr(model, "output_name", "")
        page.figure(
            partial(figures.pole_zero_figure, model, sources.relative),
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
        partial(
            figures.mode_shape_figure,
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


def add_theory(page: Page, modes: Sequence[ModeRow], theory: Theory, agreement: Agreement) -> None:
    """Add identified frequencies beside theory's, through the uncertainties of both."""
    page.paragraph(theory.source)
    rows, parts = [], []
    for mode in modes:
        beside = agreement.of(mode)
        hertz = f"{mode.omega / _TURN:.{decimals(mode.omega_sd / _TURN, 4)}f}"
        if beside is None:
            rows.append([mode.name, hertz, *(["–"] * 6)])
            continue
        k = beside.number - 1
        digits = decimals(beside.uncertainty * beside.predicted / _TURN, 4)
        rows.append(
            [
                f"{mode.name} ({beside.number})",
                hertz,
                f"{beside.predicted / _TURN:.{digits}f}",
                f"{100 * beside.deviation:+.2g}",
                small(100 * beside.uncertainty),
                signed(beside.z),
                f"{100 * beside.damping_ratio:.4g}",
                signed(beside.damping_z),
            ]
        )
        parts.append(
            [
                f"{beside.number}",
                f"{theory.natural_frequencies[k] / _TURN:.4f}",
                *(f"{100 * own_part[k]:+.3f}" for own_part in theory.contributions.values()),
                f"{100 * theory.type_b[k]:.3f}",
            ]
        )
    page.table(
        [
            "mode (of theory)",
            "identified [Hz]",
            "theory [Hz]",
            "off [%]",
            "uncertainty [%]",
            "z",
            "theory ζ [%]",
            "z of ζ",
        ],
        rows,
        "Identified modes beside theory. z is the deviation over its standard uncertainty, that of theory and of the "
        "identified frequency together; that of the damping has the identified part alone: theory takes it as given.",
    )
    if parts and theory.contributions:
        page.table(
            ["mode", "ideal [Hz]", *(f"{name} [%]" for name in theory.contributions), "together [%]"],
            parts,
            "The budget of theory: standard uncertainty of every predicted frequency from each source, of type B. "
            "One source moves all modes together.",
        )
    if agreement.is_doubtful:
        page.warning(sentence(agreement.verdict), tone="doubt")
    else:
        page.paragraph(sentence(agreement.verdict))
