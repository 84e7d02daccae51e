"""A move of a rig that leaves no swing: limits of its axis and its beam, what is known of its modes, the command."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from beam_ident.amplitude.curves import AmplitudeCurves
from beam_ident.errors import IdentificationError
from beam_ident.excitation.sampled import Quantity
from beam_ident.modal.model import ModalModel
from beam_ident.shaping.choice import Choice, choose_move
from beam_ident.shaping.command import Move, s_curve
from beam_ident.shaping.known_beam import AxisErrors, KnownBeam, PoleDrift, SwingLaw, swing_law
from beam_ident.shaping.time_optimal import MoveTask
from beam_ros.errors import UsageError
from beam_ros.excitation.optimal import THEORY_SD, led_model, rig_limits, theory_of_drive
from beam_ros.excitation.plan import plan_excitation
from beam_ros.rig.rig import Rig

MOVED_SD = 5e-4, 0.1
"""What temperature, and a servo that yields to the beam, move identified frequencies and damping ratios, relative."""

_TICKS_PER_PERIOD = 6.0
"""A mode of theory with fewer ticks in a period is left out: commands hardly reach it."""
_HEIGHTS = 60
_SLOWER = (1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0, 4.0)
_OVERLAP = 0.25
"""Modes within so much of a frequency are parts of one whose damping depends on its swing."""
_QUANTITIES: dict[str, Quantity] = {
    "acceleration": "acceleration",
    "velocity": "velocity",
    "position": "position",
}


@dataclass(frozen=True, eq=False)
class RigMove:
    """A chosen move on its rig.

    Attributes
    ----------
    choice : Choice
    rig : Rig -- that plays it
    source : str -- what the modes are taken from
    notes : tuple of str -- what the prediction does not hold
    """

    choice: Choice
    rig: Rig
    source: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class MoveOrder:
    """What is wanted of a move.

    Parameters
    ----------
    start, end : float -- from home [m]
    aim : float -- largest swing afterwards [m]
    jerk : float, optional
        Largest [m/s^3]; by default ``excitation.max_jerk``, or the largest acceleration in a period of the highest
        mode.
    drift : PoleDrift, optional -- by default by what is known of the modes
    """

    start: float
    end: float
    aim: float
    jerk: float | None = None
    drift: PoleDrift | None = None


def shape_for_rig(
    rig: Rig,
    order: MoveOrder,
    identified: ModalModel | None = None,
    *,
    curves: AmplitudeCurves | None = None,
    axis: AxisErrors | None = None,
    progress: Callable[[str, float], None] = lambda phrase, share: None,
) -> RigMove:
    """Return the shortest move on a rig that exceeds an aim with less than 5 % probability.

    Parameters
    ----------
    rig : Rig
    order : MoveOrder
    identified : ModalModel, optional -- None: the rig's theory
    curves : AmplitudeCurves, optional -- of frequency and damping over amplitude, where they were identified
    axis : AxisErrors, optional -- how the hub strays from its commands; None: it follows exactly
    progress : callable -- called with a phrase and the share done

    Raises
    ------
    UsageError
        A hub that is led by forces; a model of another drive or without modes; no move within the limits.
    """
    if rig.hub.command_mode == "effort":
        raise UsageError(
            "hub.command_mode is effort: a hub that is pushed moves as its friction lets it, and no command fixes "
            "its motion; expected acceleration, velocity or position: set hub.command_mode, with a servo on the axis"
        )
    theory = theory_of_drive(rig)
    try:
        return _shaped(rig, order, theory, identified, curves, axis, progress)
    except IdentificationError as err:
        raise UsageError(f"no move was shaped: {err}") from err


def _shaped(
    rig: Rig,
    order: MoveOrder,
    theory: ModalModel,
    identified: ModalModel | None,
    curves: AmplitudeCurves | None,
    axis: AxisErrors | None,
    progress: Callable[[str, float], None],
) -> RigMove:
    known = _reached(theory, rig.hub.period) if identified is None else led_model(identified, theory)
    known = known.driven_by("acceleration")
    _require_one_beam(known, theory)
    law, known = _law(rig, curves, known)
    sds = THEORY_SD if identified is None else MOVED_SD
    errors = axis or AxisErrors()
    before = None if order.start == 0.0 else math.copysign(1.0, order.start)
    beam = KnownBeam(known, order.drift or PoleDrift(*sds), replace(errors, before=before), law)
    limits = rig_limits(rig, theory, identified)
    highest_hz = float(np.max(known.frequencies_hz))
    jerk = order.jerk or rig.excitation.max_jerk or rig.hub.max_acceleration * highest_hz
    limits = replace(limits, axis=replace(limits.axis, jerk=jerk))
    task = MoveTask(order.start, order.end, limits, _QUANTITIES[rig.hub.command_mode])
    choice = choose_move(
        task,
        beam,
        order.aim,
        textbook=(theory.natural_frequencies, theory.damping_ratios),
        progress=progress,
    )
    found = with_move(rig, choice.chosen.move, order)
    plan_excitation(found)
    source = "the rig's theory" if identified is None else "the identified model"
    return RigMove(choice, found, source, tuple(_notes(beam, identified, axis, curves, choice)))


def _require_one_beam(known: ModalModel, theory: ModalModel) -> None:
    """Refuse a model that is nearer to another unit, a thousand times as large or small, than to the rig."""
    lowest, expected = float(np.min(known.frequencies_hz)), float(np.min(theory.frequencies_hz))
    if abs(math.log(lowest / expected)) > 0.5 * math.log(1000.0):
        raise UsageError(
            f"the model's first mode is at {lowest:.3g} Hz, where the rig's theory has {expected:.3g} Hz; expected a "
            "model of this rig: is one of them in units a thousand times too large or small? Give the --rig-file of "
            "the beam that was identified, and frequencies in rad/s"
        )


def unshaped_beside(found: RigMove) -> Rig:
    """Return the rig with the S-curve that takes as long as the chosen move, or longer where the gate asks for it.

    Raises
    ------
    UsageError
        The gate refuses every S-curve that is not many times as long.
    """
    choice = found.choice
    move, task = choice.chosen.move, choice.task
    order = MoveOrder(task.start, task.end, choice.aim)
    for slower in _SLOWER:
        plain = s_curve(
            task.distance,
            task.limits.axis,
            task.period_s,
            quantity=task.quantity,
            duration_s=slower * (move.duration_s - task.period_s),
        )
        rig = with_move(found.rig, plain, order)
        try:
            plan_excitation(rig)
        except UsageError:
            if slower == _SLOWER[-1]:
                raise
            continue
        break
    return rig


def with_move(rig: Rig, move: Move, order: MoveOrder) -> Rig:
    """Return the rig with an excitation that plays a move."""
    return rig.with_values(
        {
            "excitation.kind": "shaped_move",
            "excitation.move_from": order.start,
            "excitation.move_to": order.end,
            "excitation.move_aim": order.aim,
            "excitation.command_period": move.period_s,
            "excitation.command": tuple(move.accelerations.tolist()),
        }
    )


def _reached(theory: ModalModel, period_s: float) -> ModalModel:
    """Return a theory without the modes that ticks cannot reach."""
    kept = theory.frequencies_hz * period_s * _TICKS_PER_PERIOD < 1.0
    size = 2 * int(np.sum(kept)) + 2 + len(theory.output_names) * (int(np.sum(kept)) + 2)
    return replace(
        theory,
        natural_frequencies=theory.natural_frequencies[kept],
        damping_ratios=theory.damping_ratios[kept],
        residues=theory.residues[:, kept],
        covariance=np.zeros((size, size)),
    )


def _law(rig: Rig, curves: AmplitudeCurves | None, model: ModalModel) -> tuple[SwingLaw | None, ModalModel]:
    """Return the law that curves show, and the model with the poles of small swings."""
    if curves is None or curves.output_name not in rig.markers.names:
        return None, model
    height = rig.markers.heights[rig.markers.names.index(curves.output_name)]
    edges = np.linspace(0.0, rig.beam.length, _HEIGHTS + 1)
    middles = 0.5 * (edges[:-1] + edges[1:])
    beam = rig.beam_model()
    shape = beam.shape(middles)[:, 0] / beam.shape([height])[0, 0]
    model = _merged(model, 2.0 * math.pi * float(np.mean(curves.frequencies_hz)))
    law, omega, zeta = swing_law(curves, model, shape, np.diff(edges))
    if law.mode != 0:
        return None, model
    omegas, zetas = model.natural_frequencies.copy(), model.damping_ratios.copy()
    omegas[0], zetas[0] = omega, max(zeta, 0.0)
    return law, replace(model, natural_frequencies=omegas, damping_ratios=zetas)


def _merged(model: ModalModel, omega: float) -> ModalModel:
    """Return a model in which the modes around a frequency [rad/s] are one.

    A fit shows a mode whose damping depends on its swing as several that overlap and move the outputs alike. Together
    their residues are the mode's; where it lies for small swings is what the curves say.
    """
    near = np.abs(model.natural_frequencies - omega) < _OVERLAP * omega
    if np.sum(near) < 2:
        return model
    n, m = model.n_modes, len(model.output_names)
    strongest = int(np.argmax(np.where(near, np.sum(np.abs(model.residues), axis=0), 0.0)))
    kept = np.flatnonzero(~near | (np.arange(n) == strongest))
    fold = np.eye(n)[kept]
    fold[kept == strongest] = near
    blocks = [np.eye(n)[kept], np.eye(n)[kept], np.eye(2)]
    whole = block_diag(*blocks, *([block_diag(np.eye(2), fold)] * m))
    return replace(
        model,
        natural_frequencies=model.natural_frequencies[kept],
        damping_ratios=model.damping_ratios[kept],
        residues=model.residues @ fold.T,
        covariance=whole @ model.covariance @ whole.T,
    )


def _notes(
    beam: KnownBeam,
    identified: ModalModel | None,
    axis: AxisErrors | None,
    curves: AmplitudeCurves | None,
    choice: Choice,
) -> list[str]:
    notes = []
    if identified is not None and beam.is_nominal:
        notes.append(
            "the model has no covariance: its poles are taken as they stand (nominal), with the drift alone; "
            "identify with `beam identify --estimator modal`, which states one"
        )
    if axis is None:
        notes.append(
            "nothing is known of how the hub follows its command: it is taken to follow exactly; keep the bag of "
            "the identification beside the model, or give a --rehearsal"
        )
    if curves is None and identified is not None:
        notes.append(
            "nothing is known of drag and of frequencies that change with the swing: identify with --amplitude, or "
            "give a --rehearsal, where the beam swings far in air"
        )
    elif beam.law is not None and curves is not None:
        largest = float(curves.amplitudes[-1])
        name = curves.output_name
        bent = choice.task.limits.over_time(choice.chosen.move.accelerations)
        tips = [k for k, what in enumerate(choice.task.limits.names) if what == "tip deflection"]
        share = float(np.max(np.abs(bent[tips]))) if tips else 0.0
        if share * _tip_limit(choice) > 2.0 * largest:
            notes.append(
                f"the curves over amplitude end at {1e3 * largest:.2g} mm of {name}, and the move bends the tip by "
                f"{1e3 * share * _tip_limit(choice):.2g} mm: the law is drawn on beyond them"
            )
    return notes


def _tip_limit(choice: Choice) -> float:
    return next(
        own.limits["tip deflection"] for own in choice.task.limits.responses if "tip deflection" in own.limits
    )
