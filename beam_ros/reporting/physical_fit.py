"""The rig's beam from identified modes, for ``beam model --fit``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import ModalModel
from beam_ident.quantities import nearest_mode
from beam_model import (
    BeamModelError,
    BeamParameters,
    Identifiability,
    ModalMeasurement,
    ParameterPrior,
    PhysicalFit,
    TheoryComparison,
    compare_with_theory,
    fit_beam,
    identifiability,
)
from beam_model.fitting.physical_fit import FREE
from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.reporting.comparison import stored_models
from beam_ros.rig.rig import Rig

_TURN = 2.0 * math.pi
_OF_BASE_MOTION = ("base_motion", "velocity", "acceleration")
_AS_PARAMETER = {
    "stiffness": "flexural_rigidity",
    "tip_mass": "tip_mass",
    "clamp_compliance": "clamp_compliance",
}
_PAIRS = (
    ("flexural_rigidity", "tip_mass"),
    ("flexural_rigidity", "clamp_compliance"),
    ("flexural_rigidity", "length"),
)


@dataclass(frozen=True)
class RigFit:
    """What identified modes say of a rig's beam.

    Attributes
    ----------
    fit : PhysicalFit
    rig_parameters : dict of str to float -- what to write into the rig file
    measured_hz, fitted_hz : ndarray, shape (n_modes,)
    measured_damping, fitted_damping : ndarray, shape (n_modes,)
    theory : TheoryComparison -- the frequencies beside those of the rig file as it is, with its budget of type B
    separation : tuple of (Identifiability, Identifiability)
        For pairs of parameters: by frequencies alone, and with the markers' residues.
    marker_names : tuple of str -- whose residues are in the fit
    """

    fit: PhysicalFit
    rig_parameters: dict[str, float]
    measured_hz: FloatArray
    fitted_hz: FloatArray
    measured_damping: FloatArray
    fitted_damping: FloatArray
    theory: TheoryComparison
    separation: tuple[tuple[Identifiability, Identifiability], ...]
    marker_names: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the fit in plain numbers."""
        fit, theory = self.fit, self.theory
        return {
            "parameters": {
                name: {"value": value, "sd": sd, "unit": unit, "inflation": inflation}
                for name, value, sd, unit, inflation in zip(
                    fit.names,
                    fit.values.tolist(),
                    fit.standard_deviations.tolist(),
                    fit.units,
                    fit.inflations.tolist(),
                    strict=True,
                )
            },
            "condition": fit.condition,
            "chi_squared": fit.chi_squared,
            "degrees_of_freedom": fit.degrees_of_freedom,
            "rig": self.rig_parameters,
            "frequencies_hz": self.measured_hz.tolist(),
            "fitted_frequencies_hz": self.fitted_hz.tolist(),
            "damping_ratios": self.measured_damping.tolist(),
            "fitted_damping_ratios": self.fitted_damping.tolist(),
            "residues_of": list(self.marker_names),
            "theory": {
                "predicted_hz": (theory.predicted / _TURN).tolist(),
                "deviations": theory.deviations.tolist(),
                "z_scores": theory.z_scores.tolist(),
                "chi_squared": theory.chi_squared,
            },
            "separation": [
                {
                    "parameters": list(alone.names),
                    "by_frequencies": _finite(alone.inflations),
                    "with_residues": _finite(beside.inflations),
                }
                for alone, beside in self.separation
            ],
        }

    def to_text(self) -> str:
        """Return the fit for a person."""
        fit = self.fit
        lines = ["parameter            value         sd            unit       sd grows, others unknown"]
        for name, value, sd, unit, inflation in zip(
            fit.names, fit.values, fit.standard_deviations, fit.units, fit.inflations, strict=True
        ):
            lines.append(f"{name:<18} {value:12.6g}  {sd:12.3g}  {unit:<14} {inflation:8.2g} times")
        lines += [
            f"condition {fit.condition:.3g}, chi-squared {fit.chi_squared:.4g} with {fit.degrees_of_freedom} degrees "
            f"of freedom{_misfit(fit)}",
            "in the rig file: "
            + ", ".join(f"{key}: {value:.6g}" for key, value in self.rig_parameters.items()),
            "",
            "mode   measured        fitted          damping   fitted     rig file as it is   deviation   z",
        ]
        for k, (measured, fitted) in enumerate(zip(self.measured_hz, self.fitted_hz, strict=True)):
            lines.append(
                f"{k + 1:4d}   {measured:9.4f} Hz   {fitted:9.4f} Hz   {100 * self.measured_damping[k]:6.3f} %  "
                f"{100 * self.fitted_damping[k]:6.3f} %   {self.theory.predicted[k] / _TURN:12.4f} Hz   "
                f"{100 * self.theory.deviations[k]:+8.3f} %   {self.theory.z_scores[k]:+5.2f}"
            )
        lines += ["", "how many times a standard deviation grows while the other parameter is unknown, too"]
        for alone, beside in self.separation:
            lines.append(
                f"  {' and '.join(alone.names):<40} by frequencies {_times(alone)}, with residues {_times(beside)}"
            )
        return "\n".join(lines)


def fit_rig(
    rig: Rig, file: Path, free: Sequence[str] = (), priors: dict[str, ParameterPrior] | None = None
) -> RigFit:
    """Fit a rig's beam to the modes in a ``model.json``.

    Parameters
    ----------
    rig : Rig -- where the fit begins, and everything that is not free
    file : Path -- what ``beam identify --report`` wrote, or its folder
    free : sequence of str -- of ``fit_beam``; by default the stiffness, and as many dampings as modes
    priors : mapping, optional -- for a tip mass or a clamp's compliance, which use the markers' residues, too

    Raises
    ------
    UsageError
        The file holds no modes of the clamped beam from the first one up, or they cannot answer the question.
    """
    parameters = rig.beam_parameters()
    model = _modal_model(file)
    n = _consecutive(model, rig, file)
    names = tuple(free) or ("stiffness", "viscous", "internal")[: 1 + min(n, 2)]
    needs_residues = any(name in ("tip_mass", "clamp_compliance") for name in names)
    index = [*range(n), *range(model.n_modes, model.n_modes + n)]
    joint = (
        model.natural_frequencies[:n],
        model.damping_ratios[:n],
        model.covariance[np.ix_(index, index)],
    )
    markers = _markers(model, rig) if needs_residues else []
    try:
        measurement = ModalMeasurement.from_arrays(*joint, *_residues(model, rig, markers, n))
        height_sd = max((rig.markers.height_uncertainties[j] for j, _ in markers), default=None)
        fit = fit_beam(measurement, parameters, names, priors, height_uncertainty=height_sd)
        sd = np.sqrt(np.diag(joint[2]))[:n]
        theory = compare_with_theory(parameters, joint[0], sd)
        separation = tuple(_separation(parameters, pair, rig, n) for pair in _PAIRS)
    except BeamModelError as err:
        raise UsageError(f"{file}: {err}") from err
    fitted = fit.parameters
    omega, zeta = fit.natural_frequencies, fit.damping_ratios
    return RigFit(
        fit,
        _in_rig_file(rig, fitted, names),
        joint[0] / _TURN,
        omega / _TURN,
        np.asarray(joint[1]),
        zeta,
        theory,
        separation,
        tuple(rig.markers.names[j] for j, _ in markers),
    )


def _modal_model(file: Path) -> ModalModel:
    models = stored_models(file)
    found = [model for model in models if isinstance(model, ModalModel)]
    if len(found) != 1 or found[0].further_inputs or found[0].structure not in _OF_BASE_MOTION:
        held = ", ".join(
            f"modes of structure {model.structure}" if isinstance(model, ModalModel) else type(model).__name__
            for model in models
        )
        raise UsageError(
            f"{file}: holds {held}; expected one modal model under the hub's motion, whose modes are the clamped "
            "ones: identify with --estimator modal and the hub's position as input"
        )
    return found[0]


def _consecutive(model: ModalModel, rig: Rig, file: Path) -> int:
    """Return how many identified modes are the first ones of the theory, one after the other."""
    ideal = rig.beam_model().natural_frequencies
    n = 0
    while n < min(model.n_modes, len(ideal)) and nearest_mode(ideal, model.natural_frequencies[n]) == n:
        n += 1
    if n == 0:
        raise UsageError(
            f"{file}: the first identified mode lies at {model.natural_frequencies[0] / _TURN:.4g} Hz, where the rig "
            f"file has none within 25 % of its own first, {ideal[0] / _TURN:.4g} Hz; give the rig file of this beam "
            "(--rig-file), or identify from the first mode up"
        )
    return n


def _markers(model: ModalModel, rig: Rig) -> list[tuple[int, int]]:
    """Return the markers that are outputs: their index in the rig and in the model."""
    known = {name: k for k, name in enumerate(model.output_names)}
    return [(j, known[name]) for j, name in enumerate(rig.markers.names) if name in known]


def _residues(
    model: ModalModel, rig: Rig, markers: Sequence[tuple[int, int]], n: int
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """Return heights, residues over gains, and their covariance; a gain's error is that of its marker's scale."""
    heights = np.array([rig.markers.heights[j] for j, _ in markers])
    if not markers:
        return heights, None, None
    slopes = []
    width = model.n_modes + 2
    for _, k in markers:
        first, gain = 2 * model.n_modes + 2 + width * k, model.gains[k]
        for mode in range(n):
            slope = np.zeros(len(model.covariance))
            slope[first], slope[first + 2 + mode] = -model.residues[k, mode] / gain**2, 1.0 / gain
            slopes.append(slope)
    J = np.array(slopes)
    residues = np.array([model.residues[k, :n] / model.gains[k] for _, k in markers])
    return heights, residues, J @ model.covariance @ J.T


def _separation(
    parameters: BeamParameters, pair: tuple[str, str], rig: Rig, n: int
) -> tuple[Identifiability, Identifiability]:
    return (
        identifiability(parameters, pair, n_modes=n),
        identifiability(parameters, pair, heights=rig.markers.heights, n_modes=n),
    )


def _in_rig_file(rig: Rig, fitted: BeamParameters, names: Sequence[str]) -> dict[str, float]:
    """Return the fitted beam as parameters of the rig file."""
    changed: dict[str, float] = {}
    if "stiffness" in names:
        if rig.beam.flexural_rigidity:
            changed["beam.flexural_rigidity"] = fitted.flexural_rigidity
        else:
            ratio = fitted.flexural_rigidity / rig.beam_parameters().flexural_rigidity
            changed["beam.youngs_modulus"] = rig.beam.youngs_modulus * ratio
    if "viscous" in names:
        changed["beam.viscous_damping"] = fitted.damping.viscous
    if "internal" in names:
        changed["beam.internal_damping"] = fitted.damping.internal
    if "tip_mass" in names:
        changed["beam.tip_mass"] = fitted.tip_mass
    if "clamp_compliance" in names:
        changed["beam.clamp_stiffness"] = (
            fitted.clamp_stiffness if math.isfinite(fitted.clamp_stiffness) else 0.0
        )
    return changed


def _misfit(fit: PhysicalFit) -> str:
    if fit.degrees_of_freedom < 1 or fit.chi_squared < fit.degrees_of_freedom + 4.0 * math.sqrt(
        2.0 * fit.degrees_of_freedom
    ):
        return ""
    return ": this beam does not explain the modes, so that the standard deviations are too small"


def _times(found: Identifiability) -> str:
    worst = float(np.max(found.inflations))
    return f"{worst:.2g} times" if math.isfinite(worst) and worst < 1e5 else "without end"


def _finite(values: FloatArray) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]


def read_priors(texts: Sequence[str]) -> dict[str, ParameterPrior]:
    """Return priors from ``NAME=MEAN:SD``.

    Raises
    ------
    UsageError
        Another form, an unknown name, or a standard deviation that is not above 0.
    """
    priors = {}
    for text in texts:
        name, _, numbers = text.partition("=")
        mean, _, sd = numbers.partition(":")
        if name not in FREE:
            raise UsageError(f"--prior {text}: expected NAME=MEAN:SD with a name of {', '.join(FREE)}")
        try:
            priors[name] = ParameterPrior(float(mean), float(sd))
        except ValueError as err:
            raise UsageError(
                f"--prior {text}: expected NAME=MEAN:SD, two numbers of which the second is above 0, as "
                "tip_mass=0.003:0.0005"
            ) from err
    return priors
