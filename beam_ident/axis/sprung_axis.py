"""An axis with a spring in its drive: fitted from where a search begins, and taken where the records prefer it.

The likelihood of such an axis has several optima. A spring that rings has one at its resonance; one that creeps, its
damping ratio near 1, explains the slow part of the deflection and nothing of the ringing. Where the ringing is below
the noise, as an encoder on the hub sees it, either may be the lower one. So each is fitted from a start of its own,
and the most likely is kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from beam_ident.arrays import FloatArray
from beam_ident.axis.axis_output_error import AxisFit, AxisOutputError, MassAndFriction
from beam_ident.axis.axis_record import AxisRecord, Piece
from beam_ident.axis.drive_spring import SpringSearch
from beam_ident.axis.inverse_dynamics import NAMES
from beam_ident.errors import EstimationError

_WORTH_A_LOOK = 0.5  # of the gain in likelihood that a spring must bring, for which one is fitted
_SAME = 0.03  # difference of two resonances and their damping ratios, as logarithms, within one optimum


@dataclass(frozen=True, eq=False)
class Sprung:
    """An axis with a spring.

    Attributes
    ----------
    parameters : MassAndFriction
    own : ndarray, shape (n_pieces, 3) -- with what every piece begins, as ``AxisOutputError.first`` takes it
    ringing : ndarray, shape (2,) -- mean squares that this is expected to have, as ``AxisOutputError.ringing``
    cost : float -- negative log-likelihood, comparable between springs of other resonances, dampings and ringings
    """

    parameters: MassAndFriction
    own: FloatArray
    ringing: FloatArray
    cost: float

    def is_like(self, other: Sprung) -> bool:
        """Return whether another one is the same optimum."""
        return all(
            abs(math.log(self.parameters.value(name) / other.parameters.value(name))) < _SAME
            for name in ("resonance", "resonance_damping")
        )


def look_for_spring(
    records: Sequence[AxisRecord],
    stiff: AxisFit,
    further: tuple[str, ...],
    drive_mass: float | None,
    plain: MassAndFriction,
) -> tuple[AxisFit | None, float]:
    """Return the fit with a spring in the drive if the records show one, else None and its least stiffness [N/m].

    The stiffness is NaN where a spring was found, and where neither fit leaves a sensor's noise.

    Parameters
    ----------
    records : sequence of AxisRecord
    stiff : AxisFit -- of the axis without a spring
    further : tuple of str -- parameters beyond ``NAMES`` that are estimated where the records show them
    drive_mass : float or None -- where it is known [kg]
    plain : MassAndFriction -- with the values of ``further`` that are kept where the records do not show them
    """
    if drive_mass is not None and not drive_mass < stiff.parameters.mass:
        raise EstimationError(
            f"drive_mass is {drive_mass:.6g} kg and the moving mass {stiff.parameters.mass:.6g} kg; the drive is a "
            "part of it: expected the inertia of rotor and pulley over the square of the pulley's radius, in kg"
        )
    pieces = [(record, piece) for record in records for piece in record.pieces]
    known = {name: plain.value(name) for name in further}
    # A delay may have followed the spring: where it leaves no noise, the search is beside mass and friction alone.
    at = stiff.parameters if stiff.is_noise else stiff.parameters.changed(known)
    rough = AxisOutputError(pieces, at, stiff.names if stiff.is_noise else NAMES)
    point = rough.minimum().state
    problem = AxisOutputError(pieces, rough.parameters(point.theta), (*NAMES, *further))
    look = SpringSearch(problem, problem.first(rough.own(point.theta)), drive_mass, stiff.inflation).look()
    own = ("resonance", "resonance_damping", *(("drive_mass",) if drive_mass is None else ()))
    n = sum(piece.n_samples for _, piece in pieces)
    price = 0.5 * len(own) * math.log(n)
    if look.gain > _WORTH_A_LOOK * price:
        best = likeliest_spring(pieces, [start.changed(known) for start in look.starts], (*NAMES, *own))
        names = (*NAMES, *further, *own)
        fit = AxisOutputError(pieces, best.parameters, names, best.ringing).fit(best.own)
        needed = fit.needed(further, n)
        if len(needed) < len(further):
            start = best.parameters.changed({name: fit.parameters.value(name) for name in needed})
            fit = AxisOutputError(pieces, start, (*NAMES, *needed, *own), best.ringing).fit(best.own)
        gain = 0.5 * n * math.log(stiff.power / fit.power)
        if gain > price * fit.inflation**2 and _is_shaken(records, fit.parameters):
            return fit, math.nan
    return None, look.stiffer_than if stiff.is_noise else math.nan


def likeliest_spring(
    pieces: Sequence[tuple[AxisRecord, Piece]], starts: Sequence[MassAndFriction], names: tuple[str, ...]
) -> Sprung:
    """Return the most likely axis with a spring of those that are reached from some starts.

    They are compared with as large a ringing expected at the beginning of the pieces as there is later. Under a wide
    guess, a spring that creeps and needs no such ringing would cost too little beside one that rings.

    Parameters
    ----------
    pieces : sequence of (AxisRecord, Piece)
    starts : sequence of MassAndFriction
    names : tuple of str -- of the parameters that are estimated
    """
    optima: list[Sprung] = []
    for start in starts:
        held = AxisOutputError(pieces, start, ())
        held = AxisOutputError(pieces, start, (), held.ringing(held.first()))
        # The beginnings alone first: while they are wrong, a step of all parameters leads far away.
        state = held.minimum(is_patient=True).state
        found = _optimum(pieces, Sprung(start, held.own(state.theta), held.ringing(state), math.inf), names)
        optima += [] if any(found.is_like(other) for other in optima) else [found]
    if len(optima) > 1:
        # Each with the ringing that it shows itself.
        optima = [_optimum(pieces, found, names) for found in optima]
    return min(optima, key=lambda found: found.cost)


def _optimum(pieces: Sequence[tuple[AxisRecord, Piece]], start: Sprung, names: tuple[str, ...]) -> Sprung:
    """Return the optimum near an axis with a spring, and the ringing that it shows."""
    problem = AxisOutputError(pieces, start.parameters, names, start.ringing)
    state = problem.minimum(start.own, is_patient=True).state
    own, parameters, ringing = (
        problem.own(state.theta),
        problem.parameters(state.theta),
        problem.ringing(state),
    )
    return Sprung(
        parameters, own, ringing, AxisOutputError(pieces, parameters, names, ringing).first(own).cost
    )


def _is_shaken(records: Sequence[AxisRecord], parameters: MassAndFriction) -> bool:
    """Return whether the records hold what shakes the spring.

    Samples of a force say what it contains below half their rate (Shannon). Above it there is only what its hold
    makes of that: a spring that is seen there would be a statement about the hold, its delay and its filters.
    """
    slowest = max(record.period_s for record in records)
    return parameters.resonance * slowest < math.pi
