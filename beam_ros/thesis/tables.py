"""The tables of the reference work: columns and rows of text, for the page and for CSV files alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc as chi_squared_tail

from beam_ident import ModalModel, OrderSelection, TransferFunctionModel, compare_step_responses
from beam_ident.quantities import r_squared, with_uncertainty
from beam_ros.arrays import FloatArray
from beam_ros.excitation.plan import plan_excitation
from beam_ros.excitation.recipes import KINDS
from beam_ros.thesis.data import AtPoint, ThesisData, hub_alone_fit_percent

_LEVEL = 0.01  # how often models that agree are said not to

_FUNCTIONS = {
    "E1": "estimation by a sweep",
    "E2": "order selection, estimation by all frequencies at once",
    "V1": "validation on another sweep",
    "V2": "validation on other phases of the multisine",
    "S": "validation on a step",
}


@dataclass(frozen=True)
class Table:
    """A table as text.

    Attributes
    ----------
    columns : tuple of str -- with units
    rows : tuple of tuple of str
    notes : tuple of str -- what follows from it, in sentences
    chosen : tuple of int -- rows that stand out
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    chosen: tuple[int, ...] = ()


def system_parameters(data: ThesisData) -> Table:
    """Return table 4.1."""
    rig = data.rigs["E1"]
    beam, model = rig.beam_parameters(), rig.beam_model()
    stated = (
        ("length of the strip", "L", rig.beam.length, "m"),
        ("width", "b", rig.beam.width, "m"),
        ("thickness", "h", rig.beam.thickness, "m"),
        ("density", "", rig.beam.density, "kg/m³"),
        ("Young's modulus", "E", rig.beam.youngs_modulus, "Pa"),
        ("flexural rigidity", "EI", beam.flexural_rigidity, "N m²"),
        ("mass per length", "ρ", beam.mass_per_length, "kg/m"),
        ("mass of the hub", "m", rig.hub.mass, "kg"),
        ("mass at the tip", "M_t", rig.beam.tip_mass, "kg"),
        ("frames per second", "", rig.camera.rate, "1/s"),
        ("exposure", "", rig.camera.exposure, "s"),
        ("ticks of the hub", "", 1.0 / rig.hub.period, "1/s"),
    )
    rows = [(what, symbol, f"{value:.6g}", unit) for what, symbol, value, unit in stated]
    rows.append(("gravity", "g", rig.beam.gravity, ""))
    for number in range(min(3, model.n_modes)):
        hertz = model.natural_frequencies[number] / (2.0 * math.pi)
        rows.append((f"clamped frequency {number + 1}, by theory", f"f_{number + 1}", f"{hertz:.4f}", "Hz"))
        rows.append(
            (
                f"damping ratio {number + 1}, as stated",
                f"ζ_{number + 1}",
                f"{model.damping_ratios[number]:.5f}",
                "1",
            )
        )
    return Table(("parameter", "symbol", "value", "unit"), tuple(rows))


def orders(data: ThesisData, at: AtPoint) -> Table:
    """Return table 4.2 or 4.3."""
    selection: OrderSelection = at.orders
    finite = [entry for entry in selection.table if math.isfinite(entry.yic)]
    by_yic = min(finite, key=lambda entry: entry.yic)
    chosen = next(entry for entry in selection.table if entry.is_chosen)
    rows = tuple(
        (
            f"{entry.n_poles}",
            f"{entry.n_zeros}",
            _number(entry.fit_percent, ".3f"),
            _number(entry.r_squared, ".6f"),
            _number(entry.yic, ".2f"),
            _number(entry.aic, ".1f"),
            _number(entry.bic, ".1f"),
            entry.refused_because or "passed",
        )
        for entry in selection.table
    )
    degree = at.transfer_functions["E2"].n_poles
    agree = (by_yic.n_poles, by_yic.n_zeros) == (chosen.n_poles, chosen.n_zeros)
    said = f"BIC among the structures that pass takes {chosen.n_poles} poles and {chosen.n_zeros} zeros; " + (
        "the lowest YIC is the same one."
        if agree
        else f"the lowest YIC has {by_yic.n_poles} and {by_yic.n_zeros}."
    )
    return Table(
        ("poles", "zeros", "FIT [%]", "R²", "YIC", "AIC", "BIC", "gates"),
        rows,
        (
            said,
            f"The models below have {degree} poles and zeros, for {degree // 2} modes that all points together show.",
        ),
        tuple(k for k, entry in enumerate(selection.table) if entry.is_chosen),
    )


def excitations(data: ThesisData) -> Table:
    """Return table 4.4."""
    rows = []
    for name in (name for name in _FUNCTIONS if name in data.experiments):
        excitation, plan = data.rigs[name].excitation, plan_excitation(data.rigs[name])
        kind = KINDS[excitation.kind]
        band = f"{excitation.start_frequency:g} – {excitation.end_frequency:g}" if kind.is_band else "–"
        rows.append(
            (
                name,
                excitation.kind.replace("_", " "),
                _FUNCTIONS[name],
                band,
                f"{plan.sampled.duration_s:.1f}",
                f"{1e3 * plan.sampled.peaks()['travel'][0]:.3f}",
                f"{plan.sampled.peaks()['acceleration'][0]:.3f}",
                f"{1e3 * plan.prediction.tip_deflection:.2f}",
            )
        )
    return Table(
        (
            "data set",
            "signal",
            "function",
            "band [Hz]",
            "length [s]",
            "travel [mm]",
            "peak [m/s²]",
            "tip [mm]",
        ),
        tuple(rows),
    )


def model_parameters(data: ThesisData, at: AtPoint) -> Table:
    """Return table 4.5 or 4.6."""
    first, second = at.transfer_functions["E1"], at.transfer_functions["E2"]
    rows: list[tuple[str, ...]] = []
    for k, name in enumerate(first.parameter_names):
        values = [
            (float(model.parameters[k]), float(model.standard_deviations[k])) for model in (first, second)
        ]
        spread = math.hypot(values[0][1], values[1][1])
        apart = f"{(values[0][0] - values[1][0]) / spread:+.1f}" if spread > 0.0 else "known"
        cells = (with_uncertainty(value, sd) for value, sd in values)
        rows.append((f"{name} [{_unit(first, name)}]", *cells, apart))
    notes = [
        "± is one standard deviation, as everywhere here. The denominator begins with 1; powers of s fall from "
        "left to right. Input and output are in metres."
    ]
    for unseen in ("V1", "V2", "S"):
        if (at.point.name, "E1", unseen) not in data.validations:
            continue
        outputs = [
            data.validations[at.point.name, name, unseen].output(at.point.name) for name in ("E1", "E2")
        ]
        rows.append((f"FIT on {unseen} [%]", *(f"{own.scores.fit_percent:.3f}" for own in outputs), "–"))
        rows.append((f"R² on {unseen}", *(r_squared(own.scores.r_squared) for own in outputs), "–"))
        rows.append((f"residual over noise on {unseen}", *(f"{own.noise_ratio:.2f}" for own in outputs), "–"))
        rows.append(
            (
                f"FIT on {unseen} of the hub alone [%]",
                *((f"{hub_alone_fit_percent(data, at.point.name, unseen):.3f}",) * 2),
                "–",
            )
        )
    # Coefficients err together: only the joint test says whether two sets of them agree.
    difference = first.parameters - second.parameters
    covariance = first.covariance + second.covariance
    free = np.flatnonzero(np.diag(covariance) > 0.0)
    scale = np.sqrt(np.diag(covariance)[free])
    joint = float(
        (difference[free] / scale)
        @ np.linalg.pinv(covariance[np.ix_(free, free)] / np.outer(scale, scale))
        @ (difference[free] / scale)
    )
    notes.append(
        f"Between E1 and E2 all coefficients together differ by chi-squared {joint:.1f} over {len(free)} of them, "
        f"p = {chi_squared_tail(len(free), joint):.2g}: {_agreement(float(chi_squared_tail(len(free), joint)))}"
    )
    return Table(("parameter", "from E1", "from E2", "difference [sd]"), tuple(rows), tuple(notes))


def _unit(model: TransferFunctionModel, name: str) -> str:
    """Return the unit of a coefficient, where input and output have one."""
    if name == "delay":
        return "s"
    zeros = model.n_poles - len(model.numerator) + 1
    power = int(name[1:]) + (zeros if name[0] == "b" else 0)
    return "1" if power == 0 else f"s^-{power}"


def _agreement(p_value: float) -> str:
    if p_value >= _LEVEL:
        return "they agree."
    return "noise alone hardly does that, and one of the two models lacks something or claims too much."


def modal_parameters(data: ThesisData) -> Table:
    """Return table 4.7."""
    rig = data.rigs["E1"]
    model = rig.beam_model()
    theory = [
        (float(w) / (2.0 * math.pi), float(z))
        for w, z in zip(model.natural_frequencies[:2], model.damping_ratios[:2], strict=True)
    ]
    rows: list[tuple[str, ...]] = []

    def add(name: str, modes: tuple[FloatArray, FloatArray, FloatArray, FloatArray]) -> None:
        cells = [name]
        for frequency, _ in theory:
            near = [
                k
                for k, omega in enumerate(modes[0])
                if abs(float(omega) / (2.0 * math.pi * frequency) - 1.0) < 0.1
            ]
            if not near:
                cells += ["–", "–"]
                continue
            best = min(near, key=lambda k: abs(float(modes[0][k]) / (2.0 * math.pi * frequency) - 1.0))
            omega, zeta, omega_sd, zeta_sd = (float(part[best]) for part in modes)
            hertz = 2.0 * math.pi
            cells.append(with_uncertainty(omega / hertz, omega_sd / hertz))
            cells.append(with_uncertainty(100.0 * zeta, 100.0 * zeta_sd))
        rows.append(tuple(cells))

    for at in data.points:
        for name, own in at.transfer_functions.items():
            add(f"transfer function at {at.point.label}, {name}", own.modes())
    for name, result in data.modal.items():
        add(f"all points at once, {name}", result.model.modes())
    rows.append(
        ("theory", *(cell for hertz, zeta in theory for cell in (f"{hertz:.4f}", f"{100.0 * zeta:.4f}")))
    )
    tips = {name: 1e3 * plan_excitation(data.rigs[name]).prediction.tip_deflection for name in data.modal}
    of_theory = (
        "theory is what was simulated."
        if data.apparatus
        else "theory inherits 2 % from the thickness of a real strip, and air, clamp and temperature shift it by "
        "tenths of a percent."
    )
    note = (
        f"± is the standard deviation of the statistics alone; {of_theory} A damping ratio holds for its "
        "amplitude: the tip swung by at most "
        + " and ".join(f"{tip:.1f} mm in {name}" for name, tip in tips.items())
        + "."
    )
    return Table(("model", "f₁ [Hz]", "ζ₁ [%]", "f₂ [Hz]", "ζ₂ [%]"), tuple(rows), (note,), (len(rows) - 1,))


def step_fits(data: ThesisData) -> Table:
    """Return table 4.8."""
    record = data.experiments["S"].record
    rows = []
    for at in data.points:
        name = at.point.name
        models: dict[str, ModalModel | TransferFunctionModel] = {
            "transfer function, E1": at.transfer_functions["E1"],
            "transfer function, E2": at.transfer_functions["E2"],
            "all points, E1": data.modal["E1"].model,
            "all points, E2": data.modal["E2"].model,
        }
        part = record.select((name,))
        compared = compare_step_responses(models, record.inputs[0], part.outputs[0].times_s, name, part)
        assert compared.measured_fit_percent is not None
        for k, label in enumerate(models):
            source = "" if label.startswith("all") else name
            own = data.validations[source, label[-2:], "S"].output(name)
            rows.append(
                (
                    f"y{at.point.number}: {label}",
                    f"{compared.measured_fit_percent[k]:.3f}",
                    f"{own.simulation_scores.fit_percent:.3f}",
                    f"{own.deflection_scores.fit_percent:.2f}",
                    f"{compared.fit_percent[0, k]:.3f}",
                    f"{own.noise_ratio:.2f}",
                )
            )
    return Table(
        (
            "model",
            "FP, measured [%]",
            "FP from rest [%]",
            "FP of the deflection [%]",
            "FP to the first model [%]",
            "residual / noise",
        ),
        tuple(rows),
        (
            "From rest nothing of the record is fitted, no offset either. The fit to the first model compares the "
            "responses of two models, without any noise.",
        ),
    )


MADE: Mapping[str, Callable[[ThesisData], Table]] = {
    "Table 4.1": system_parameters,
    "Table 4.2": lambda data: orders(data, data.points[0]),
    "Table 4.3": lambda data: orders(data, data.points[1]),
    "Table 4.4": excitations,
    "Table 4.5": lambda data: model_parameters(data, data.points[0]),
    "Table 4.6": lambda data: model_parameters(data, data.points[1]),
    "Table 4.7": modal_parameters,
    "Table 4.8": step_fits,
}
"""What makes each table, in their order."""


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "–"
