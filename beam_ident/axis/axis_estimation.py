"""Mass and friction of a driven axis from its force and its position, in open and in closed loop.

Two estimators look at the same record. *Output error* simulates the positions from the force: the best there is
where the position's sensor makes the noise. *Inverse dynamics with instrumental variables* explains the force by the
motion: the one to trust where forces act that nobody measured, which a simulation adds up twice. The colour of what
the simulation leaves decides between them, and where they disagree the result says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.axis.axis_output_error import COLOURED, MODAL_MASS, AxisFit, AxisOutputError, MassAndFriction
from beam_ident.axis.axis_record import AxisRecord, require_motion
from beam_ident.axis.axis_result import AxisCheck, AxisResult, in_known_units, units_of
from beam_ident.axis.inverse_dynamics import (
    NAMES,
    InverseDynamicsFit,
    fit_inverse_dynamics,
    unmodelled_forces,
)
from beam_ident.data.argument_checks import chosen_input, finite_row, require_output, require_records
from beam_ident.data.records import OutputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.noise.scores import Scores, Whiteness, are_rounding
from beam_ident.numerics.blas_threads import on_one_thread

_MUCH_BETTER = 4.0  # times smaller standard deviations, for which output error is kept all the same
_APART, _DIFFERENT = 4.0, 0.01  # standard deviations between the two methods, and share of the estimate


@on_one_thread
def identify_axis(
    records: TimeRecord | Sequence[TimeRecord],
    *,
    force: str | None = None,
    position: str | None = None,
    reference: str | None = None,
    delay_s: float | None = None,
    mass: float | None = None,
    mass_sd: float = 0.0,
    offset: float | None = None,
    modes: Sequence[tuple[float, float]] = (),
) -> AxisResult:
    """Estimate mass, friction, constant force and delay of an axis from the force on it and its position.

    Parameters
    ----------
    records : TimeRecord or sequence of TimeRecord
        The force as an input [N], or what is proportional to it, as a current; the position as an output [m].
    force, position : str, optional -- names of these signals, where there are several
    reference : str, optional
        Name of the input that holds the position which a servo was to follow [m]: instruments are made of it, for
        records with forces that nobody measured.
    delay_s : float, optional
        By how much the force acts later than its stamps say [s]; None: estimated where the record shows one.
    mass, mass_sd : float, optional
        Where the mass is known and the input no force: the force constant is estimated in its place [kg].
    offset : float, optional
        Where the constant force against +x is known, 0 for a level axis without a cable [N]: dry friction may then
        differ between the directions. It needs an input in N, or ``mass``.
    modes : sequence of (natural frequency [rad/s], damping ratio)
        Of a structure that stands on the axis, while that is held still, as ``identify`` finds them with the position
        as its input. The mass of each that the record shows is estimated; "mass" is then what does not swing. The
        structure must be at rest when the record begins.

    Returns
    -------
    AxisResult

    Raises
    ------
    EstimationError
        An axis that never moved, or not in both directions; too few samples; signals that are not there.
    """
    loaded = _loaded(records, force, position, reference, _modes(modes))
    _require_numbers(delay_s=delay_s, mass=mass, offset=offset)
    if mass is not None and not mass > 0.0:
        raise EstimationError(f"mass is {mass!r} kg; expected a number above 0")
    if not (math.isfinite(mass_sd) and mass_sd >= 0.0):
        raise EstimationError(f"mass_sd is {mass_sd!r} kg; expected a number of at least 0")
    require_motion(loaded)
    swinging = tuple(f"{MODAL_MASS}{k}" for k in range(1, len(modes) + 1))
    further = (*swinging, *(("delay",) if delay_s is None else ()), "viscous_difference")
    motions = None if reference is None else [_followed(own) for own in loaded]
    start = fit_inverse_dynamics(loaded, 0.0 if delay_s is None else delay_s)
    simulated = _output_error(loaded, start.parameters, further)
    inverse = _inverse_dynamics(loaded, simulated, further, motions)
    chosen = _chosen(simulated, inverse)
    return _result(loaded, chosen, simulated, inverse, mass, mass_sd, offset)


def check_axis(result: AxisResult, records: TimeRecord | Sequence[TimeRecord]) -> AxisCheck:
    """Return how an identified axis does on records that it was not estimated from.

    Parameters
    ----------
    result : AxisResult
    records : TimeRecord or sequence of TimeRecord -- with signals of the names that the result has

    Raises
    ------
    EstimationError
        The records lack these signals, or the axis does not move in them.
    """
    loaded = _loaded(records, result.force_name, result.position_name, None, result.modes)
    require_motion(loaded)
    return _checked(loaded, parameters_of(result), (), is_fit=False)


def parameters_of(result: AxisResult) -> MassAndFriction:
    """Return the parameters of a result for the input as it was recorded, in its unit."""
    scale = 1.0
    if "force_constant" in result.names:
        scale = 1.0 / result.value("force_constant")
        mass = result.known_mass * scale
    else:
        mass = result.value("mass")
    half = 0.5 * (result.resistance_forward - result.resistance_backward)
    return MassAndFriction(
        mass,
        result.value("viscous") * scale,
        result.value("coulomb") * scale,
        half * scale,
        result.value("delay"),
        result.value("viscous_difference") * scale,
        tuple(result.value(f"{MODAL_MASS}{k}") * scale for k in range(1, len(result.modes) + 1)),
    )


@dataclass(frozen=True, eq=False)
class _Estimate:
    """One of the two estimators' answer."""

    method: str
    parameters: MassAndFriction
    names: tuple[str, ...]
    covariance: FloatArray


def _loaded(
    records: TimeRecord | Sequence[TimeRecord],
    force: str | None,
    position: str | None,
    reference: str | None,
    modes: tuple[tuple[float, ...], ...],
) -> list[AxisRecord]:
    found = []
    for record in require_records(records):
        drive = chosen_input(record, force)
        output = _position(record, position)
        require_output(output.name, output.values[output.is_valid])
        wanted = None if reference is None else record.input(reference)
        if output.unit != "m":
            raise EstimationError(
                f"the position {output.name!r} is in {output.unit!r}; expected m: scale it, or name another output"
            )
        found.append(AxisRecord(drive, output, wanted, modes))
    return found


def _modes(given: Sequence[tuple[float, float]]) -> tuple[tuple[float, ...], ...]:
    found = []
    for mode in given:
        pair = tuple(finite_row("a mode", mode))
        if len(pair) != 2 or not pair[0] > 0.0 or not 0.0 <= pair[1] < 1.0:
            raise EstimationError(
                f"a mode is {mode!r}; expected its natural frequency [rad/s] and its damping ratio, 0 to 1"
            )
        found.append((float(pair[0]), float(pair[1])))
    return tuple(found)


def _position(record: TimeRecord, name: str | None) -> OutputSignal:
    if name is not None:
        return record.output(name)
    if len(record.outputs) > 1:
        raise EstimationError(
            f"record {record.name!r} has the outputs {', '.join(record.output_names)}; say with position= which is "
            "the axis"
        )
    return record.outputs[0]


def _require_numbers(**given: float | None) -> None:
    for name, value in given.items():
        if value is not None and not (
            isinstance(value, int | float | np.number)
            and not isinstance(value, bool)
            and math.isfinite(value)
        ):
            raise EstimationError(f"{name} is {value!r}; expected a finite number")


def _followed(record: AxisRecord) -> FloatArray:
    """Return the reference at the positions' stamps, NaN where it is not known."""
    assert record.reference is not None
    first, last = record.reference.span_s
    t = record.times_s
    inside = (t >= first) & (t <= last)
    return np.where(inside, record.reference.signal()(np.clip(t, first, last)), np.nan)


def _output_error(records: Sequence[AxisRecord], start: MassAndFriction, further: tuple[str, ...]) -> AxisFit:
    """Return the fit with those further parameters that the records show."""
    pieces = [(record, piece) for record in records for piece in record.pieces]
    start = replace(start, mass=start.mass if start.mass > 0.0 else _rough_mass(records))
    plain = AxisOutputError(pieces, start, NAMES).fit()
    full = AxisOutputError(pieces, plain.parameters, (*NAMES, *further)).fit()
    if not _is_noise(full):
        # What is missing in the plain fit may have led it far away: once more from where the inverse dynamics with
        # all of it is.
        rough = fit_inverse_dynamics(records, start.delay, (*NAMES, *further)).parameters
        rough = replace(rough, mass=rough.mass if rough.mass > 0.0 else start.mass)
        other = AxisOutputError(pieces, rough, (*NAMES, *further)).fit()
        full = other if _is_noise(other) else full
    needed = _needed(full, further, sum(piece.n_samples for _, piece in pieces))
    if len(needed) == len(further):
        return full
    if not needed:
        return plain
    begin = full.parameters.changed({name: start.value(name) for name in further if name not in needed})
    return AxisOutputError(pieces, begin, (*NAMES, *needed)).fit()


def _inverse_dynamics(
    records: Sequence[AxisRecord],
    simulated: AxisFit,
    further: tuple[str, ...],
    motions: Sequence[FloatArray] | None,
) -> InverseDynamicsFit:
    """Return the fit with those further parameters that it, or a simulation that describes the records, shows."""
    if _is_noise(simulated):
        names = tuple(name for name in simulated.names if name != "delay")
        return fit_inverse_dynamics(records, simulated.parameters.delay, names, motions)
    known = simulated.parameters.delay if "delay" not in simulated.names else 0.0
    if motions is None:
        # A servo answers the forces that nobody measured, and its answer alone looks like a delay.
        further = tuple(name for name in further if name != "delay")
    full = fit_inverse_dynamics(records, known, (*NAMES, *further), motions)
    n_values = sum(piece.n_samples for record in records for piece in record.pieces)
    needed = _needed(full, further, n_values)
    if "delay" in needed:
        # A delay is linear in small steps: once more from where the first one led, if it then is one still.
        again = fit_inverse_dynamics(records, full.parameters.delay, (*NAMES, *needed), motions)
        if "delay" in _needed(again, further, n_values):
            return again
        needed = tuple(name for name in needed if name != "delay")
    return fit_inverse_dynamics(records, known, (*NAMES, *needed), motions)


def _needed(fit: AxisFit | InverseDynamicsFit, further: tuple[str, ...], n_values: int) -> tuple[str, ...]:
    """Return which of further parameters a fit shows, as the Bayesian information criterion asks of each."""
    least = math.sqrt(math.log(n_values))
    return tuple(
        name
        for j, name in enumerate(fit.names)
        if name in further and abs(fit.parameters.value(name)) > least * math.sqrt(fit.covariance[j, j])
    )


def _is_noise(simulated: AxisFit) -> bool:
    """Return whether what a simulation leaves is the noise of a sensor."""
    return simulated.converged and simulated.inflation < COLOURED


def _rough_mass(records: Sequence[AxisRecord]) -> float:
    """Return the force's rms over that of the smoothed acceleration [kg]."""
    pushes = [float(np.std(record.drive.values)) for record in records]
    gains = [float(np.sqrt(np.mean(np.square(np.gradient(own.velocities, own.times_s))))) for own in records]
    return max(pushes) / max(max(gains), 1e-300)


def _chosen(simulated: AxisFit, inverse: InverseDynamicsFit) -> _Estimate:
    """Return output error's answer, or that of inverse dynamics where forces that nobody measured outweigh noise."""
    n = len(NAMES)
    own = float(np.linalg.slogdet(simulated.covariance[:n, :n])[1])
    other = float(np.linalg.slogdet(inverse.covariance[:n, :n])[1])
    is_far_better = simulated.converged and own < other - 2.0 * n * math.log(_MUCH_BETTER)
    if _is_noise(simulated) or is_far_better:
        return _Estimate("output_error", simulated.parameters, simulated.names, simulated.covariance)
    return _Estimate("instrumental_variables", inverse.parameters, inverse.names, inverse.covariance)


def _result(
    records: Sequence[AxisRecord],
    chosen: _Estimate,
    simulated: AxisFit,
    inverse: InverseDynamicsFit,
    mass: float | None,
    mass_sd: float,
    offset: float | None,
) -> AxisResult:
    swinging = sorted((name for name in chosen.names if name.startswith(MODAL_MASS)), key=len)
    order = (*NAMES, *swinging, "viscous_difference", "delay")
    names = tuple(name for name in order if name in chosen.names)
    places = [chosen.names.index(name) for name in names]
    estimates = np.array([chosen.parameters.value(name) for name in names])
    covariance = chosen.covariance[np.ix_(places, places)]
    is_output_error = chosen.method == "output_error"
    other: InverseDynamicsFit | AxisFit = inverse if is_output_error else simulated
    other_values = np.array([other.parameters.value(name) for name in other.names])
    other_estimates, other_covariance = _in_all(other.names, other_values, other.covariance)
    warnings = _warnings(
        chosen.method, *_in_all(names, estimates, covariance), other_estimates, other_covariance
    )
    check = _checked(records, chosen.parameters, simulated.residuals if is_output_error else (), is_fit=True)
    if mass is not None:
        estimates, covariance = _scaled(names, estimates, covariance, mass, mass_sd)
        other_estimates, other_covariance = in_known_units(other_estimates, other_covariance, mass, mass_sd)
        names = ("force_constant", *names[1:])
    if offset is not None:
        k = names.index("offset")
        estimates[k] = 2.0 * (estimates[k] - offset)
        covariance[k] *= 2.0
        covariance[:, k] *= 2.0
        names = tuple("coulomb_difference" if name == "offset" else name for name in names)
    drive = records[0].drive
    return AxisResult(
        names,
        estimates,
        covariance,
        units_of(names, drive.unit, mass is not None),
        chosen.method,
        other_estimates,
        np.sqrt(np.diag(other_covariance)),
        drive.name,
        records[0].output.name,
        drive.unit,
        math.nan if mass is None else mass,
        math.nan if offset is None else offset,
        records[0].modes,
        sum(piece.n_samples for record in records for piece in record.pieces),
        sum(len(record.pieces) for record in records),
        check,
        simulated.converged if is_output_error else True,
        simulated.reason if is_output_error else "linear in the parameters",
        simulated.iterations if is_output_error else 0,
        tuple(warnings),
    )


def _in_all(
    names: tuple[str, ...], estimates: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the four parameters of both methods, the mass with all that swings on it, and their covariance."""
    rows = np.array(
        [
            [float(name == own or (own == "mass" and name.startswith(MODAL_MASS))) for name in names]
            for own in NAMES
        ]
    )
    return rows @ estimates, rows @ covariance @ rows.T


def _scaled(
    names: tuple[str, ...], estimates: FloatArray, covariance: FloatArray, mass: float, mass_sd: float
) -> tuple[FloatArray, FloatArray]:
    """Turn the input's unit into newtons; a delay stays what it is."""
    if "delay" not in names:
        return in_known_units(estimates, covariance, mass, mass_sd)
    n = len(names) - 1
    scaled, own = in_known_units(estimates[:n], covariance[:n, :n], mass, mass_sd)
    grown = np.zeros((n + 1, n + 1))
    grown[:n, :n], grown[n, n] = own, covariance[n, n]
    return np.append(scaled, estimates[n]), grown


def _warnings(
    method: str,
    estimates: FloatArray,
    covariance: FloatArray,
    other: FloatArray,
    other_covariance: FloatArray,
) -> list[str]:
    found = []
    sd = np.sqrt(np.diag(covariance))
    apart = np.abs(estimates - other) / np.sqrt(np.square(sd) + np.diag(other_covariance))
    worst = int(np.argmax(apart))
    if apart[worst] > _APART and abs(estimates[worst] - other[worst]) > _DIFFERENT * abs(estimates[worst]):
        found.append(
            f"output error and inverse dynamics disagree by {apart[worst]:.1f} standard deviations on the "
            f"{NAMES[worst]} ({estimates[worst]:.4g} and {other[worst]:.4g}): the axis does something that the model "
            "lacks, or its noise is unlike what either expects; the difference is an honest uncertainty"
        )
    if method == "instrumental_variables":
        found.append(
            "forces that nobody measured outweigh the noise of the position: the estimates are those of inverse "
            "dynamics, with standard deviations that the colour of these forces gives"
        )
    if estimates[2] < -4.0 * sd[2]:
        found.append("the dry friction comes out negative: check the signs of force and position")
    if estimates[0] <= 0.0:
        found.append("the mass comes out negative: force and position point in opposite directions")
    return found


def _checked(
    records: Sequence[AxisRecord],
    parameters: MassAndFriction,
    residuals: Sequence[FloatArray],
    is_fit: bool,
) -> AxisCheck:
    """Return how the parameters do; with residuals of the simulation where they are at hand."""
    pieces = [(record, piece) for record in records for piece in record.pieces]
    if not residuals:
        residuals = AxisOutputError(pieces, parameters, ()).minimum().state.residuals
    measured = []
    for record, piece in pieces:
        own = record.positions[piece.samples]
        measured.append(own - np.mean(own))
    y, e = np.concatenate(measured), np.concatenate(residuals)
    whiteness = Whiteness.of(e)
    terms = unmodelled_forces(records, parameters, is_fit)
    return AxisCheck(
        Scores.of(y, e).fit_percent,
        float(np.std(e)),
        whiteness.is_white or are_rounding(y, e),
        whiteness.verdict,
        tuple(terms),
    )
