"""The rig's theory and its known sources of error, as a report weighs them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from beam_ident import ModalModel
from beam_ident.quantities import nearest_mode
from beam_ident.report.evidence import ErrorSources, Theory
from beam_model import AirDrag, BeamModel, amplitude_law
from beam_model.fitting.theory_comparison import UncertaintyBudget, compare_with_theory
from beam_ros.arrays import FloatArray
from beam_ros.rig.rig import Rig

_STEEL_PER_KELVIN = -1.25e-4  # of natural frequencies: half of what Young's modulus of steel loses
_STRIP_POINTS = 120


def theory_of_rig(
    rig: Rig, structure: str, is_simulated: bool = False, temperature_k: float | None = None
) -> Theory:
    """Return the rig's theory: the one that every table, figure and file holds identified modes against.

    Parameters
    ----------
    rig : Rig
    structure : str -- what drives the beam: a moved base leaves the clamped modes, a force the free hub's
    is_simulated : bool -- whether the data are of a computed beam, which is that of theory
    temperature_k : float, optional -- the budget of what is identified counts the temperature already

    Notes
    -----
    The budget is that of ``beam_model.fitting.compare_with_theory``: usual uncertainties of a rolled steel strip in a
    clamp, in air. It knows clamped modes only; with a free hub no uncertainty of theory is known. The clock belongs
    to what was identified, and is counted there.
    """
    model: BeamModel = rig.beam_model()
    is_free = structure == "force"
    ideal = model.free_hub_natural_frequencies if is_free else model.natural_frequencies
    damping = model.free_hub_damping_ratios if is_free else model.damping_ratios
    which = "strip on a free hub" if is_free else "clamped strip"
    of_beam = f"Theory: the Galerkin model of the {which} of the rig file"
    if is_simulated:
        source = (
            f"{of_beam}. The data are simulated with just this model, so that it has no uncertainty: neither a "
            "real clamp nor air that is not in the rig file takes anything off."
        )
        if is_free:
            return Theory(source, ideal, damping, ideal, is_exact=True)
        predicted, contributions = ideal, {}
    elif is_free:
        source = f"{of_beam}. Its budget of uncertainty is known for clamped modes only, and is left out."
        return Theory(source, ideal, damping, ideal)
    else:
        budget = UncertaintyBudget(camera_clock=0.0)
        if temperature_k is not None:
            budget = replace(budget, temperature=0.0)
        compared = compare_with_theory(rig.beam_parameters(), ideal, np.zeros(len(ideal)), budget)
        of_air = f" and {-100 * budget.air_shift:.2g} % for the air that moves along"
        source = (
            f"{of_beam}. The prediction takes {-100 * budget.clamp_shift:.2g} % off for a real clamp"
            f"{'' if rig.beam.still_air else of_air}, as is usual."
        )
        predicted = compared.predicted
        contributions = {name: part for name, part in compared.contributions.items() if np.any(part)}
    heights = np.array(rig.markers.heights)
    height_sd = np.array(rig.markers.height_uncertainties)
    residues, slopes = model.motion_residues(heights), model.motion_residues(heights, derivative=1)
    strip = np.linspace(0.0, rig.beam.length, _STRIP_POINTS)
    names = rig.markers.names
    return Theory(
        source=source,
        natural_frequencies=ideal,
        damping_ratios=damping,
        predicted=predicted,
        contributions=contributions,
        is_exact=is_simulated,
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


def error_sources(
    structure: str,
    models: Sequence[Any],
    temperature_k: float | None = None,
    is_simulated: bool = False,
) -> ErrorSources:
    """Return what the scatter of the samples cannot show: time base, temperature, scale.

    Parameters
    ----------
    structure : str
    models : sequence of models
    temperature_k : float, optional -- standard uncertainty of the beam's temperature [K]
    is_simulated : bool -- whether the data were computed, on a time base without error

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
    return ErrorSources(
        time_base=0.0 if is_simulated else UncertaintyBudget().camera_clock,
        temperature_k=temperature_k,
        frequency_per_kelvin=_STEEL_PER_KELVIN,
        scale=scale,
    )
