"""The rig's theory and its known sources of error, as a report weighs them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from beam_ident import ModalModel
from beam_ident.report.evidence import ErrorSources, ModeRow, Theory
from beam_ident.report.quantities import nearest_mode
from beam_model import AirDrag, BeamModel, amplitude_law
from beam_model.fitting.theory_comparison import UncertaintyBudget, compare_with_theory
from beam_ros.arrays import FloatArray
from beam_ros.rig.rig import Rig

_STEEL_PER_KELVIN = -1.25e-4  # of natural frequencies: half of what Young's modulus of steel loses
_STRIP_POINTS = 120
_UNSEEN = 1e3  # relative: a mode that was not identified weighs nothing


def theory_of_rig(rig: Rig, structure: str, modes: Sequence[ModeRow]) -> Theory:
    """Return the rig's theory beside identified modes, with its budget of type B.

    Parameters
    ----------
    rig : Rig
    structure : str -- what drives the beam: a moved base leaves the clamped modes, a force the free hub's
    modes : sequence of ModeRow -- what was identified

    Notes
    -----
    The budget is that of ``beam_model.fitting.compare_with_theory``: usual uncertainties of a rolled steel strip in a
    clamp, in air. It knows clamped modes only; with a free hub the ideal frequencies stand alone.
    """
    model: BeamModel = rig.beam_model()
    if structure == "force":
        return Theory(
            "Theory: the Galerkin model of the strip on a free hub. Its budget of uncertainty is known for clamped "
            "modes only, and is left out.",
            model.free_hub_natural_frequencies,
            model.free_hub_damping_ratios,
            model.free_hub_natural_frequencies,
        )
    ideal = model.natural_frequencies
    measured, sd = np.array(ideal), _UNSEEN * np.array(ideal)
    for mode in modes:
        k = nearest_mode(ideal, mode.omega)
        if k is not None:
            measured[k], sd[k] = mode.omega, mode.omega_sd if math.isfinite(mode.omega_sd) else 0.0
    n = max([k + 1 for k in range(len(ideal)) if sd[k] < ideal[k]], default=1)
    compared = compare_with_theory(rig.beam_parameters(), measured[:n], sd[:n], UncertaintyBudget())
    budget = UncertaintyBudget()
    of_air = (
        "" if rig.beam.still_air else f" and {-100 * budget.air_shift:.2g} % for the air that moves along"
    )
    heights = np.array(rig.markers.heights)
    height_sd = np.array(rig.markers.height_uncertainties)
    residues, slopes = model.motion_residues(heights), model.motion_residues(heights, derivative=1)
    strip = np.linspace(0.0, rig.beam.length, _STRIP_POINTS)
    names = rig.markers.names
    return Theory(
        source=(
            "Theory: the Galerkin model of the clamped strip of the rig file. The prediction takes "
            f"{-100 * budget.clamp_shift:.2g} % off for a real clamp{of_air}, as is usual; a simulated beam "
            "has neither."
        ),
        natural_frequencies=ideal,
        damping_ratios=model.damping_ratios,
        predicted=np.concatenate([compared.predicted, ideal[n:]]),
        contributions={name: _padded(part, len(ideal)) for name, part in compared.contributions.items()},
        chi_squared=compared.chi_squared,
        residues={name: residues[j] for j, name in enumerate(names)},
        residue_sd={name: np.abs(slopes[j]) * height_sd[j] for j, name in enumerate(names)},
        heights=strip,
        shapes=model.motion_residues(strip),
        places={name: (float(heights[j]), float(height_sd[j])) for j, name in enumerate(names)},
        over_amplitude=partial(_over_amplitude, rig, model),
    )


def _over_amplitude(
    rig: Rig, model: BeamModel, name: str, frequency_hz: float, amplitudes: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return what the rig's drag and large deflections make of a mode's frequency [Hz] and damping ratio."""
    mode = nearest_mode(model.natural_frequencies, 2.0 * math.pi * frequency_hz)
    if mode is None or name not in rig.markers.names:
        return None
    drag = AirDrag(rig.beam.width, rig.simulation.drag_coefficient)
    height = rig.markers.heights[rig.markers.names.index(name)]
    law = amplitude_law(model, mode, height, drag, is_geometric=rig.simulation.large_deflections)
    return law.frequencies(amplitudes) / (2.0 * math.pi), law.damping_ratios(amplitudes)


def _padded(values: FloatArray, n: int) -> FloatArray:
    return np.pad(values, (0, n - len(values)), constant_values=np.nan)


def error_sources(structure: str, models: Sequence[Any], temperature_k: float | None = None) -> ErrorSources:
    """Return what the scatter of the samples cannot show: time base, temperature, scale.

    Parameters
    ----------
    structure : str
    models : sequence of models
    temperature_k : float, optional -- standard uncertainty of the beam's temperature [K]

    Notes
    -----
    A marker on a moved base follows it one to one. By how much its gain differs from 1, and how well the gain is
    known, is the uncertainty of its scale.
    """
    scale = {}
    for model in models:
        if isinstance(model, ModalModel) and structure == "base_motion" and not model.further_inputs:
            for name, gain, sd in zip(model.output_names, model.gains, model.gain_sd, strict=True):
                scale[name] = float(math.hypot(gain - 1.0, sd))
    sources = ErrorSources(
        time_base=UncertaintyBudget().camera_clock, frequency_per_kelvin=_STEEL_PER_KELVIN, scale=scale
    )
    return replace(sources, temperature_k=temperature_k)
