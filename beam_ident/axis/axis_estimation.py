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
from beam_ident.axis import axis_doubts
from beam_ident.axis.axis_output_error import MODAL_MASS, AxisFit, AxisOutputError, MassAndFriction
from beam_ident.axis.axis_record import AxisRecord, Piece, require_motion
from beam_ident.axis.axis_result import AxisCheck, AxisResult, in_known_units, units_of
from beam_ident.axis.inverse_dynamics import (
    NAMES,
    InverseDynamicsFit,
    fit_inverse_dynamics,
    unmodelled_forces,
)
from beam_ident.axis.sprung_axis import look_for_spring
from beam_ident.data.argument_checks import chosen_input, finite_row, require_output, require_records
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.noise.scores import Scores, Whiteness, are_rounding
from beam_ident.numerics.blas_threads import on_one_thread

_MUCH_BETTER = 4.0  # times smaller standard deviations, for which output error is kept all the same
_UNDECIDED = (
    "whether the drive is compliant cannot be told: neither a stiff drive nor one with a spring leaves a sensor's "
    "noise; record faster moves, without forces that nobody measures"
)
_SEEN = 3.0  # standard deviations that a mass must be from zero


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
    encoder: str = "hub",
    drive_mass: float | None = None,
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
    encoder : {"hub", "drive"}
        Where the position is measured. "drive": on the motor's side of a compliant drive, with ``drive_mass`` or
        without; the stiffness of the drive is then looked for. It needs an input in N.
    drive_mass : float, optional
        Mass ahead of the spring of a compliant drive, as J / r^2 of a rotor with its pulley [kg]: the stiffness is
        looked for, with the encoder on the hub too.

    Returns
    -------
    AxisResult

    Raises
    ------
    EstimationError
        An axis that never moved, or not in both directions; too few samples; signals that are not there.

    Notes
    -----
    A compliant drive is two masses with a spring and a damper between them. The force acts on the first, which is
    rotor, pulley or nut; friction, a constant force and ``modes`` act on the second, the hub. Positions of the hub
    alone tell the product of both masses over the stiffness, not its factors: hence ``drive_mass``. A spring is found
    where the Bayesian information criterion prefers it, the colour of what it leaves counted, and it swings slower
    than half the rate of the force, whose samples say nothing of what would shake a faster one; else ``stiffer_than``
    of the result is a lower limit of the stiffness.
    """
    loaded = _loaded(records, force, position, reference, _modes(modes), encoder)
    _require_numbers(delay_s=delay_s, mass=mass, offset=offset, drive_mass=drive_mass)
    is_asked = encoder == "drive" or drive_mass is not None
    if is_asked:
        _require_spring(loaded, encoder, drive_mass, mass)
    if mass is not None and not mass > 0.0:
        raise EstimationError(f"mass is {mass!r} kg; expected a number above 0")
    if not (math.isfinite(mass_sd) and mass_sd >= 0.0):
        raise EstimationError(f"mass_sd is {mass_sd!r} kg; expected a number of at least 0")
    require_motion(loaded)
    swinging = tuple(f"{MODAL_MASS}{k}" for k in range(1, len(modes) + 1))
    further = (*swinging, *(("delay",) if delay_s is None else ()), "viscous_difference")
    motions = None if reference is None else [_followed(own) for own in loaded]
    start = fit_inverse_dynamics(loaded, 0.0 if delay_s is None else delay_s)
    _require_mass(start.parameters.mass, start.covariance[0, 0], loaded[0])
    simulated = _output_error(loaded, start.parameters, further)
    inverse = _inverse_dynamics(loaded, simulated, further, motions)
    stiffer_than = math.nan
    if is_asked:
        compliant, stiffer_than = look_for_spring(loaded, simulated, further, drive_mass, start.parameters)
        simulated = compliant or simulated
    chosen = _chosen(simulated, inverse)
    _require_mass(chosen.parameters.mass, chosen.covariance[0, 0], loaded[0])
    result = _result(loaded, chosen, simulated, inverse, motions, mass, mass_sd, offset)
    if is_asked and not result.is_compliant and math.isnan(stiffer_than):
        result = replace(result, warnings=(*result.warnings, _UNDECIDED))
    return replace(
        result,
        encoder=encoder,
        known_drive_mass=math.nan if drive_mass is None else float(drive_mass),
        stiffer_than=stiffer_than,
    )


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
    loaded = _loaded(records, result.force_name, result.position_name, None, result.modes, result.encoder)
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
    resonance, zeta, drive_mass = result.drive_resonance, 0.0, 0.0
    if result.is_compliant:
        drive_mass = result.value("drive_mass") if "drive_mass" in result.names else result.known_drive_mass
        zeta = 0.5 * result.value("drive_damping") * resonance / result.value("stiffness")
    return MassAndFriction(
        mass,
        result.value("viscous") * scale,
        result.value("coulomb") * scale,
        half * scale,
        result.value("delay"),
        result.value("viscous_difference") * scale,
        tuple(result.value(f"{MODAL_MASS}{k}") * scale for k in range(1, len(result.modes) + 1)),
        resonance,
        zeta,
        drive_mass,
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
    encoder: str,
) -> list[AxisRecord]:
    if encoder not in ("hub", "drive"):
        raise EstimationError(f"encoder is {encoder!r}; expected 'hub' or 'drive'")
    found = []
    for record in require_records(records):
        drive = chosen_input(record, force)
        if np.ptp(drive.values) == 0.0:
            raise EstimationError(
                f"the force {drive.name!r} is constant ({drive.values[0]:g}); expected the force that moved it. "
                "Check the channel, or name another input"
            )
        output = _position(record, position)
        require_output(output.name, output.values[output.is_valid])
        wanted = None if reference is None else record.input(reference)
        if output.unit != "m":
            raise EstimationError(
                f"the position {output.name!r} is in {output.unit!r}; expected m: scale it, or name another output"
            )
        # From the force's first sample on: of seconds since 1970 the integrals of a force keep too few digits.
        start = float(drive.times_s[0])
        found.append(
            AxisRecord(
                _input_from(drive, start),
                replace(output, times_s=output.times_s - start),
                None if wanted is None else _input_from(wanted, start),
                modes,
                encoder == "drive",
            )
        )
    return found


def _input_from(drive: InputSignal, start_s: float) -> InputSignal:
    """Return an input whose stamps count from some instant."""
    gaps = tuple(replace(gap, start_s=gap.start_s - start_s, end_s=gap.end_s - start_s) for gap in drive.gaps)
    return replace(drive, times_s=drive.times_s - start_s, gaps=gaps)


def _require_mass(mass: float, variance: float, record: AxisRecord) -> None:
    """Raise EstimationError where the acceleration does not follow the force, or does so backwards."""
    sd = math.sqrt(variance)
    names = f"position {record.output.name!r} accelerates"
    if mass < -_SEEN * sd:
        raise EstimationError(
            f"the {names} against the force {record.drive.name!r}: the mass would be {mass:.4g}. Expected one "
            "direction for both: change the sign of one, exchange them if they are swapped, or take away a "
            "spring that holds the axis"
        )
    if not mass > _SEEN * sd:
        raise EstimationError(
            f"it is not seen that the {names} with the force {record.drive.name!r}: mass {mass:.3g} +- {sd:.2g}. Is "
            "it the right input, on the same clock? Move with more acceleration"
        )


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


def _require_spring(
    records: Sequence[AxisRecord], encoder: str, drive_mass: float | None, mass: float | None
) -> None:
    if drive_mass is not None and not drive_mass > 0.0:
        raise EstimationError(f"drive_mass is {drive_mass!r} kg; expected a number above 0")
    if mass is not None or records[0].drive.unit != "N":
        raise EstimationError(
            "the stiffness of a drive is looked for under a force in N and without mass=; the input "
            f"{records[0].drive.name!r} is in {records[0].drive.unit!r}: find its force constant with mass= and "
            "without encoder= and drive_mass=, then scale it to N"
        )
    if encoder == "drive" and records[0].modes:
        raise EstimationError(
            "modes= are of a structure on the hub, whose motion an encoder on the drive does not measure; leave out "
            "one of modes= and encoder='drive'"
        )


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
    start = _possible(start, _rough_mass(records))
    problem = AxisOutputError(pieces, start, NAMES)
    plain = problem.fit()
    begin = plain.parameters
    if "delay" in further:
        begin = replace(begin, delay=problem.likeliest_delay(plain.state))
    full = AxisOutputError(pieces, begin, (*NAMES, *further)).fit()
    if not full.is_noise:
        # What is missing in the plain fit may have led it far away: once more from where the inverse dynamics with
        # all of it is.
        rough = fit_inverse_dynamics(records, start.delay, (*NAMES, *further)).parameters
        other = AxisOutputError(pieces, _possible(rough, start.mass), (*NAMES, *further)).fit()
        full = other if other.is_noise else full
    if not full.state.cost < plain.state.cost:
        return plain  # what can do more ended worse, as from a delay that noise made likely
    needed = full.needed(further, sum(piece.n_samples for _, piece in pieces))
    if "delay" in needed:
        full = _at_likeliest_delay(pieces, full)
        needed = full.needed(further, sum(piece.n_samples for _, piece in pieces))
    if len(needed) == len(further):
        return full
    if not needed:
        return plain
    begin = full.parameters.changed({name: start.value(name) for name in further if name not in needed})
    found = AxisOutputError(pieces, begin, (*NAMES, *needed)).fit()
    return found if found.state.cost < plain.state.cost else plain


def _at_likeliest_delay(pieces: Sequence[tuple[AxisRecord, Piece]], fit: AxisFit) -> AxisFit:
    """Return a fit, or one some periods of the force beside it that leaves less."""
    while True:
        delay = AxisOutputError(pieces, fit.parameters, fit.names).likeliest_delay(fit.state)
        other = AxisOutputError(pieces, replace(fit.parameters, delay=delay), fit.names)
        if delay == fit.parameters.delay:
            return fit
        found = other.fit(other.own(fit.state.theta))
        if not found.state.cost < fit.state.cost:
            return fit
        fit = found


def _inverse_dynamics(
    records: Sequence[AxisRecord],
    simulated: AxisFit,
    further: tuple[str, ...],
    motions: Sequence[FloatArray] | None,
) -> InverseDynamicsFit:
    """Return the fit with those further parameters that it, or a simulation that describes the records, shows."""
    if simulated.is_noise:
        if motions is None:
            motions = _simulated_motions(records, simulated)
        names = tuple(name for name in simulated.names if name != "delay")
        return fit_inverse_dynamics(records, simulated.parameters.delay, names, motions)
    known = simulated.parameters.delay if "delay" not in simulated.names else 0.0
    if motions is None:
        # A servo answers the forces that nobody measured, and its answer alone looks like a delay.
        further = tuple(name for name in further if name != "delay")
    full = fit_inverse_dynamics(records, known, (*NAMES, *further), motions)
    n_values = sum(piece.n_samples for record in records for piece in record.pieces)
    needed = full.needed(further, n_values)
    if "delay" in needed:
        # A delay is linear in small steps: once more from where the first one led, if it then is one still.
        again = fit_inverse_dynamics(records, full.parameters.delay, (*NAMES, *needed), motions)
        if "delay" in again.needed(further, n_values):
            return again
        needed = tuple(name for name in needed if name != "delay")
    return fit_inverse_dynamics(records, known, (*NAMES, *needed), motions)


def _simulated_motions(records: Sequence[AxisRecord], simulated: AxisFit) -> list[FloatArray]:
    """Return the motion that the force makes by a fit, at every record's stamps; NaN where the axis is at rest."""
    motions, left = [], iter(simulated.residuals)
    for record in records:
        motion = np.full(len(record.times_s), np.nan)
        for piece in record.pieces:
            motion[piece.samples] = record.positions[piece.samples] - next(left)
        motions.append(motion)
    return motions


def _possible(found: MassAndFriction, mass: float) -> MassAndFriction:
    """Return what a simulation can begin with: with friction that drives it an axis runs away, to infinity."""
    viscous = max(found.viscous, 0.0)
    difference = min(max(found.viscous_difference, -2.0 * viscous), 2.0 * viscous)
    positive = found.mass if found.mass > 0.0 else mass
    return replace(found, mass=positive, viscous=viscous, viscous_difference=difference)


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
    if simulated.is_noise or is_far_better:
        return _Estimate("output_error", simulated.parameters, simulated.names, simulated.covariance)
    return _Estimate("instrumental_variables", inverse.parameters, inverse.names, inverse.covariance)


def _result(
    records: Sequence[AxisRecord],
    chosen: _Estimate,
    simulated: AxisFit,
    inverse: InverseDynamicsFit,
    motions: Sequence[FloatArray] | None,
    mass: float | None,
    mass_sd: float,
    offset: float | None,
) -> AxisResult:
    swinging = sorted((name for name in chosen.names if name.startswith(MODAL_MASS)), key=len)
    own = ("resonance", "resonance_damping", "drive_mass")
    order = (*NAMES, *swinging, "viscous_difference", *own, "delay")
    names = tuple(name for name in order if name in chosen.names)
    places = [chosen.names.index(name) for name in names]
    estimates = np.array([chosen.parameters.value(name) for name in names])
    covariance = chosen.covariance[np.ix_(places, places)]
    is_output_error = chosen.method == "output_error"
    other: InverseDynamicsFit | AxisFit = inverse if is_output_error else simulated
    other_values = np.array([other.parameters.value(name) for name in other.names])
    other_estimates, other_covariance = _in_all(other.names, other_values, other.covariance)
    in_all = _in_all(names, estimates, covariance)
    warnings = [] if is_output_error else axis_doubts.of_unmeasured_forces(records, inverse, motions)
    warnings += axis_doubts.of_jumps(records)
    warnings += axis_doubts.negative_friction(*in_all)
    if not chosen.parameters.resonance:
        # Inverse dynamics know of no spring.
        warnings += axis_doubts.of_methods(*in_all, other_estimates, other_covariance)
    check = _checked(records, chosen.parameters, simulated.residuals if is_output_error else (), is_fit=True)
    warnings += axis_doubts.of_terms(check.terms)
    names, estimates, covariance = _with_stiffness(names, estimates, covariance, chosen.parameters)
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


def _with_stiffness(
    names: tuple[str, ...], estimates: FloatArray, covariance: FloatArray, parameters: MassAndFriction
) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Turn resonance and damping ratio of a compliant drive into stiffness and damping.

    k = omega^2 m_r and d = 2 zeta omega m_r, with the reduced mass m_r = m_d (m - m_d) / m of drive and hub.
    """
    spring = parameters.spring()
    if spring is None:
        return names, estimates, covariance
    mass, drive, omega = parameters.mass, parameters.drive_mass, parameters.resonance
    reduced = spring.stiffness / omega**2
    by_mass = {"mass": (drive / mass) ** 2, "drive_mass": 1.0 - 2.0 * drive / mass}
    k, d = names.index("resonance"), names.index("resonance_damping")
    slopes = np.eye(len(names))
    slopes[k, k], slopes[d, d] = 2.0 * omega * reduced, 2.0 * omega * reduced
    slopes[d, k] = spring.damping / omega
    for name, slope in by_mass.items():
        if name in names:
            slopes[[k, d], names.index(name)] = slope / reduced * np.array([spring.stiffness, spring.damping])
    values = estimates.copy()
    values[k], values[d] = spring.stiffness, spring.damping
    turned = {"resonance": "stiffness", "resonance_damping": "drive_damping"}
    return tuple(turned.get(name, name) for name in names), values, slopes @ covariance @ slopes.T


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
    # The inverse dynamics have no spring, which they would take for forces.
    terms = [] if parameters.resonance else unmodelled_forces(records, parameters, is_fit)
    return AxisCheck(
        Scores.of(y, e).fit_percent,
        float(np.std(e)),
        whiteness.is_white or are_rounding(y, e),
        whiteness.verdict,
        tuple(terms),
        not parameters.resonance,
    )
