"""The best excitation for a rig: its axis's and its beam's limits, its camera, and what is known of its modes.

What is known comes from the rig's theory, or from the last identification. Whatever that says, the loads that the
gate of the hub predicts from the rig file are among the limits: a design never leaves them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beam_ident.design.experiment import ExperimentDesign, design_experiment
from beam_ident.design.limits import ExcitationLimits, LimitedResponse
from beam_ident.design.precision import Observation
from beam_ident.errors import IdentificationError
from beam_ident.excitation import AxisLimits, ShapedMultisine
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure, StructureKind
from beam_model import BeamModel, LoadTrace, state_space
from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.rig.rig import Rig

THEORY_SD = 0.02, 0.3
"""Of natural frequencies and damping ratios that a rig file gives, relative: a rolled strip, a guessed damping."""
IDENTIFIED_SD = 5e-4, 0.05
"""What temperature and amplitude move them from one experiment to the next, besides the stated deviations."""

_MARGIN = 0.95
_OVERDAMPED = 0.95
_AS_IDENTIFIED = ", as identified"


@dataclass(frozen=True, eq=False)
class RigDesign:
    """An optimal excitation of a rig.

    Attributes
    ----------
    design : ExperimentDesign
    rig : Rig -- with this excitation
    source : str -- what the design rests on
    """

    design: ExperimentDesign
    rig: Rig
    source: str

    def to_dict(self) -> dict[str, Any]:
        """Return the design's figures for a machine (SI, standard deviations relative)."""
        design = self.design
        return {
            "criterion": str(design.criterion),
            "source": self.source,
            "gain": design.gain,
            "worst_parameter": design.worst_parameter,
            "worst_gain": design.worst_gain,
            "excitations": {
                name: {
                    "recipe": own.recipe.to_dict(),
                    "value": own.value,
                    "relative_sd": own.pole_sd,
                    "share_of_limits": own.shares,
                }
                for name, own in (
                    ("optimal", design.optimal),
                    ("chirp", design.chirp),
                    ("multisine", design.multisine),
                )
            },
        }


def design_for_rig(
    rig: Rig,
    criterion: str = "D",
    identified: ModalModel | None = None,
    *,
    frequency_sd: float | None = None,
    damping_sd: float | None = None,
    noise: float | None = None,
    progress: Callable[[str, float], None] = lambda phrase, share: None,
) -> RigDesign:
    """Return the excitation of the rig's length and band that leaves the smallest uncertainty within all limits.

    Parameters
    ----------
    rig : Rig
        Its ``excitation.duration`` and ``excitation.still`` together are the length; lines lie from
        ``start_frequency`` to ``end_frequency``.
    criterion : str -- D, A or c:NAME, see ``design_experiment``
    identified : ModalModel, optional -- what the last identification found; None: the rig's theory
    frequency_sd, damping_sd : float, optional
        How well natural frequencies and damping ratios are known, relative; by default by what is known of them.
    noise : float, optional
        Standard deviation of a displacement [m]; by default what was identified, or
        ``simulation.displacement_noise``.
    progress : callable -- called with a phrase and the share done

    Raises
    ------
    UsageError
        No mode lies in the band; the model was identified from another drive; the limits leave no excitation.
    """
    theory = theory_of_drive(rig)
    known = theory if identified is None else led_model(identified, theory)
    known = _within(known, (rig.excitation.start_frequency, rig.excitation.end_frequency))
    defaults = THEORY_SD if identified is None else IDENTIFIED_SD
    try:
        design = design_experiment(
            known,
            rig_limits(rig, theory, identified),
            _observation(rig, known, noise, is_identified=identified is not None),
            rig.excitation.duration + rig.excitation.still,
            (rig.excitation.start_frequency, rig.excitation.end_frequency),
            criterion,
            frequency_sd=defaults[0] if frequency_sd is None else frequency_sd,
            damping_sd=defaults[1] if damping_sd is None else damping_sd,
            margin=_MARGIN,
            progress=progress,
        )
    except IdentificationError as err:
        raise UsageError(f"no excitation was designed: {err}") from err
    found = rig.with_values(excitation_values(design.recipe))
    share = largest_load(found)
    if share > _MARGIN:
        # Where the gate's model holds what poles and residues do not: strong or coupled damping, air.
        level = found.excitation.acceleration * _MARGIN / share
        found = found.with_values({"excitation.acceleration": level})
    source = "the rig's theory" if identified is None else "the identified model"
    return RigDesign(design, found, source)


def excitation_values(recipe: ShapedMultisine) -> dict[str, object]:
    """Return the rig's parameters that make a recipe, by dotted names."""
    names = ("frequencies", "amplitudes", "line_phases", "acceleration", "duration", "still")
    return {"excitation.kind": recipe.kind, **{f"excitation.{name}": getattr(recipe, name) for name in names}}


def theory_of_drive(rig: Rig) -> ModalModel:
    """Return the rig's theory as a modal model of its markers: of a led hub, or of one under force."""
    names, heights = rig.markers.names, rig.markers.heights
    if rig.hub.command_mode == "effort":
        return _under_force(rig.beam_model(), "force", names, heights, "displacement")
    return _led(rig.beam_model(), "base_motion", names, heights)


def _led(
    model: BeamModel,
    structure: StructureKind,
    names: tuple[str, ...],
    heights: tuple[float, ...],
    derivative: int = 0,
    scale: float = 1.0,
) -> ModalModel:
    """Return displacements of a led beam; else a derivative of the deflection times ``scale``, without the hub."""
    is_whole = derivative == 0 and structure == "base_motion"
    kept = model.damping_ratios < _OVERDAMPED
    residues = scale * model.motion_residues(heights, derivative)
    residual = scale * model.residual_terms(heights, derivative)
    residual = residual + residues[:, ~kept] @ model.natural_frequencies[~kept] ** -2.0
    gains = np.full(len(names), 1.0 if is_whole else 0.0)
    return _modal(
        structure,
        names,
        model.natural_frequencies[kept],
        model.damping_ratios[kept],
        residues[:, kept],
        residual,
        gains,
    )


def _under_force(
    model: BeamModel,
    structure: StructureKind,
    names: tuple[str, ...],
    heights: tuple[float, ...],
    quantity: str,
    scale: float = 1.0,
) -> ModalModel:
    """Return a quantity of the beam whose free hub is driven by a force, times ``scale``."""
    form = state_space(model, heights, "force", quantity).pole_residue_form()
    ratios = -form.poles.real / np.abs(form.poles)
    kept = (form.poles.imag > 0.0) & (ratios < _OVERDAMPED)
    poles = form.poles[kept]
    # rho / (s - p) and its conjugate make -2 Re(rho p*) / d(s); what is left over them is damping's, and small.
    residues = -2.0 * scale * np.real(form.residues[kept] * np.conj(poles)[:, None]).T
    moves = quantity in ("displacement", "hub")
    gains = np.full(len(names), scale / model.parameters.total_mass if moves else 0.0)
    residual = np.zeros(len(names)) if structure == "mobility" else scale * form.direct
    return _modal(structure, names, np.abs(poles), ratios[kept], residues, residual, gains)


def _modal(
    structure: StructureKind,
    names: tuple[str, ...],
    omegas: FloatArray,
    zetas: FloatArray,
    residues: FloatArray,
    residual: FloatArray,
    gains: FloatArray,
) -> ModalModel:
    size = 2 * len(omegas) + 2 + len(names) * (len(omegas) + 2)
    return ModalModel(
        structure,
        "hub",
        names,
        omegas,
        zetas,
        residues,
        residual,
        gains,
        0.0,
        0.0,
        np.zeros((size, size)),
        np.ones(len(names)),
    )


def rig_limits(rig: Rig, theory: ModalModel, identified: ModalModel | None = None) -> ExcitationLimits:
    """Return everything that an excitation of the rig must keep: what its hub's gate checks, and jerk.

    Parameters
    ----------
    rig : Rig
    theory : ModalModel -- of ``theory_of_drive``
    identified : ModalModel, optional -- the same loads count with its poles, too
    """
    model, half, length = rig.beam_model(), 0.5 * rig.beam.thickness, rig.beam.length
    axis = AxisLimits(
        travel=rig.hub.travel / 2,
        speed=rig.hub.max_speed,
        acceleration=rig.hub.max_acceleration,
        jerk=rig.excitation.max_jerk or math.inf,
    )
    tip, strain = ("tip deflection",), ("root strain",)
    bent = {tip[0]: rig.hub.max_tip_deflection, strain[0]: rig.beam.max_root_strain}
    mass = model.parameters.total_mass
    if rig.hub.command_mode == "effort":
        inertia, of_drive = np.zeros((1, theory.n_modes)), 1.0
        responses = [
            _both(
                _under_force(model, "receptance", tip, (length,), "deflection"),
                _under_force(model, "receptance", strain, (0.0,), "curvature", half),
                bent,
            ),
            LimitedResponse(
                _under_force(model, "force", ("free hub's travel",), (0.0,), "hub"),
                {"free hub's travel": rig.hub.travel / 2},
            ),
            LimitedResponse(
                _under_force(model, "mobility", ("free hub's speed",), (0.0,), "hub"),
                {"free hub's speed": rig.hub.max_speed},
            ),
        ]
    else:
        # The force is that on the whole mass, and the modes' inertia beside it.
        inertia = -(model.basis.participation * model.participation_factors)[None, :]
        inertia, of_drive = inertia[:, model.damping_ratios < _OVERDAMPED], mass
        responses = [
            _both(
                _led(model, "acceleration", tip, (length,)),
                _led(model, "acceleration", strain, (0.0,), 2, half),
                bent,
            )
        ]
    force = _modal(
        "accelerance",
        ("hub force",),
        theory.natural_frequencies,
        theory.damping_ratios,
        inertia,
        np.zeros(1),
        np.array([of_drive]),
    )
    responses.append(LimitedResponse(force, {"hub force": rig.hub.max_effort}))
    if identified is not None:
        responses += [_renamed(own.with_poles(identified, identified)) for own in responses]
    scale = mass if rig.hub.command_mode == "effort" else 1.0
    return ExcitationLimits(axis, tuple(responses), scale, rig.hub.period)


def _both(one: ModalModel, other: ModalModel, limits: dict[str, float]) -> LimitedResponse:
    """Return the outputs of two models with the same modes as one response."""
    return LimitedResponse(
        _modal(
            one.structure,
            (*one.output_names, *other.output_names),
            one.natural_frequencies,
            one.damping_ratios,
            np.concatenate([one.residues, other.residues]),
            np.concatenate([one.residual_terms, other.residual_terms]),
            np.concatenate([one.gains, other.gains]),
        ),
        limits,
    )


def _renamed(response: LimitedResponse) -> LimitedResponse:
    names = tuple(name + _AS_IDENTIFIED for name in response.model.output_names)
    limits = {name + _AS_IDENTIFIED: limit for name, limit in response.limits.items()}
    return LimitedResponse(replace(response.model, output_names=names), limits)


def led_model(identified: ModalModel, theory: ModalModel) -> ModalModel:
    """Return an identified model from the quantity of the rig's drive, if it is one.

    Raises
    ------
    UsageError
        Several inputs, or another drive than the rig's.
    """
    if identified.further_inputs:
        raise UsageError(
            f"the model has the inputs {', '.join(identified.input_names)}: expected one, the hub; identify with the "
            "hub alone"
        )
    is_led = ModalStructure(theory.structure).is_motion
    if is_led and ModalStructure(identified.structure).is_motion:
        return identified.driven_by(theory.structure)
    if identified.structure != theory.structure:
        raise UsageError(
            f"the model was identified as {identified.structure!r}, and the rig's hub.command_mode drives "
            f"{theory.structure!r}; give the model of an experiment in this mode, or set hub.command_mode"
        )
    return identified


def _within(model: ModalModel, band_hz: tuple[float, float]) -> ModalModel:
    """Return a model with its modes in the band alone; what lies above it stays as its static share."""
    low, high = band_hz
    inside = (model.frequencies_hz > low) & (model.frequencies_hz < high)
    if not np.any(inside):
        raise UsageError(
            f"none of the modes at {', '.join(f'{f:.4g}' for f in model.frequencies_hz)} Hz lies in the band of "
            f"{low:g} to {high:g} Hz; change excitation.start_frequency or excitation.end_frequency"
        )
    n, m = model.n_modes, len(model.output_names)
    above = model.frequencies_hz >= high
    residual = model.residual_terms + model.residues[:, above] @ model.natural_frequencies[above] ** -2.0
    kept = np.flatnonzero(inside)
    columns = [*kept, *(n + kept), 2 * n, 2 * n + 1]
    for j in range(m):
        first = 2 * n + 2 + j * (n + 2)
        columns += [first, first + 1, *(first + 2 + kept)]
    return replace(
        model,
        natural_frequencies=model.natural_frequencies[kept],
        damping_ratios=model.damping_ratios[kept],
        residues=model.residues[:, kept],
        residual_terms=residual,
        covariance=model.covariance[np.ix_(columns, columns)],
    )


def _observation(rig: Rig, model: ModalModel, noise: float | None, *, is_identified: bool) -> Observation:
    if noise is not None:
        levels = np.full(len(model.output_names), noise)
    else:
        levels = (
            model.noise_sd
            if is_identified
            else np.full(len(model.output_names), rig.simulation.displacement_noise)
        )
    is_led = ModalStructure(model.structure).is_motion
    return Observation(
        rig.camera.rate,
        dict(zip(model.output_names, levels.tolist(), strict=True)),
        rig.camera.exposure,
        clock_rate_sd=rig.camera.clock_tolerance,
        input_sd=rig.hub.encoder_resolution / math.sqrt(12.0) if is_led else 0.0,
    )


def largest_load(rig: Rig) -> float:
    """Return the largest of the loads that the hub's gate predicts for the rig's excitation, over its limit."""
    from beam_ros.excitation.recipes import recipe_of_rig

    model, is_free = rig.beam_model(), rig.hub.command_mode == "effort"
    trace = LoadTrace(model, rig.hub.period, rig.beam.thickness, is_free=is_free)
    accelerations = recipe_of_rig(rig).sample(rig.hub.period).accelerations
    trace.add(accelerations * (model.parameters.total_mass if is_free else 1.0))
    return max(
        trace.loads.tip_deflection / rig.hub.max_tip_deflection,
        trace.loads.root_strain / rig.beam.max_root_strain,
        trace.loads.hub_force / rig.hub.max_effort,
        trace.position / (rig.hub.travel / 2),
        trace.velocity / rig.hub.max_speed,
    )
