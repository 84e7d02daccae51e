"""Responses by stepped sines: one frequency at a time, fitted rather than transformed.

In every segment input and outputs are fitted by an offset and a sine of the frequency that was
played (three parameters; IEEE Std 1057), or by one of free frequency (four parameters), at
any stamps.  A fit needs no whole number of periods and no regular grid, and its
residuals give the variance of every line.

The input's amplitude is that of its continuous signal: what a hold does to a sampled sine
(``responses.periods.hold_gain``) and what an exposure takes from an output are accounted for.
Images of a held input are orthogonal to the sine over a segment and stay in the residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit as student_quantile

from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.data.argument_checks import (
    chosen_input,
    finite_row,
    require_output,
    require_record,
    require_size,
)
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.responses.doubts import with_doubts
from beam_ident.responses.periods import exposure_gain, hold_gain

_ITERATIONS = 30
_MIN_SAMPLES = 8
_APART = 6.0  # standard deviations between the frequencies of input and output
_TURNED = 0.05  # rad over a step: what a transient may do as well, and hardly changes the response
_SAME = 1e-7  # of the frequency: rounding
_CLOCK_LEVEL = 1e-4  # chance that transients, which differ from step to step, pass for one rate of a clock
_MIN_STEPS = 4  # that tell how much rates scatter


@dataclass(frozen=True, eq=False)
class SineFit:
    """A sine in noise.

    Attributes
    ----------
    omega : float -- [rad/s]
    amplitude : complex -- ``Re(amplitude e^(j omega t)) + offset``, t as given
    offset : float
    covariance : ndarray, shape (3, 3) or (4, 4)
        Of real part, imaginary part, offset and, where it is free, omega.
    noise_sd : float
    n_samples : int
    converged : bool
    """

    omega: float
    amplitude: complex
    offset: float
    covariance: FloatArray
    noise_sd: float
    n_samples: int
    converged: bool

    @property
    def omega_sd(self) -> float:
        """Standard deviation of the frequency [rad/s], 0 where it was given."""
        return math.sqrt(max(float(self.covariance[3, 3]), 0.0)) if len(self.covariance) > 3 else 0.0

    @property
    def amplitude_variance(self) -> float:
        """``E |error|^2`` of the complex amplitude."""
        return float(self.covariance[0, 0] + self.covariance[1, 1])


def _seen(times_s: FloatArray, values: FloatArray, omega: float) -> tuple[FloatArray, FloatArray]:
    """Return the stamps and values that were seen, or refuse what no sine is fitted to."""
    times, data = finite_row("stamps [s]", times_s), np.asarray(values, dtype=np.float64)
    if data.shape != times.shape or np.any(np.isinf(data)):
        raise EstimationError(
            f"values of shape {data.shape} for {len(times)} stamps, {np.count_nonzero(np.isinf(data))} of them "
            "infinite; expected one for each, NaN where nothing was seen"
        )
    seen = np.isfinite(data)
    times, data = times[seen], data[seen]
    require_size("the signal", data)
    if len(data) < _MIN_SAMPLES:
        raise EstimationError(f"{len(data)} samples for a sine; expected at least {_MIN_SAMPLES}")
    if not (math.isfinite(omega) and omega > 0.0):
        raise EstimationError(f"omega is {omega}; expected a frequency > 0 in rad/s")
    return times, data


def fit_sine(
    times_s: FloatArray, values: FloatArray, omega: float, is_frequency_free: bool = False
) -> SineFit:
    """Fit a sine and an offset at any stamps, in the sense of least squares.

    Parameters
    ----------
    times_s, values : ndarray, shape (n,) -- stamps [s]; NaN values are left out
    omega : float -- frequency, or where to start [rad/s]
    is_frequency_free : bool
        Whether the frequency is estimated too; the start must be within about half a period
        over the length of the record.

    Raises
    ------
    EstimationError
        Fewer than eight samples, a frequency that is not positive, stamps that do not determine the sine.
    """
    times, data = _seen(times_s, values, omega)
    if is_frequency_free:
        require_output("values", data)
    middle = 0.5 * float(times[0] + times[-1])
    late = times - middle  # from the middle, frequency and phase hardly depend on each other
    found, design, converged = np.zeros(0), np.zeros((0, 0)), True
    for _ in range(_ITERATIONS if is_frequency_free else 1):
        cosine, sine = np.cos(omega * late), -np.sin(omega * late)
        columns = [cosine, sine, np.ones(len(late))]
        if is_frequency_free:
            previous = np.linalg.lstsq(np.stack(columns, axis=1), data, rcond=None)[0]
            columns.append(late * (previous[0] * sine - previous[1] * cosine))
        design = np.stack(columns, axis=1)
        # By the root mean square that a sine has: a column of zeros must not be blown up to one.
        scale = np.full(design.shape[1], math.sqrt(0.5 * len(late)))
        if is_frequency_free:
            scale[3] = max(float(np.linalg.norm(design[:, 3])), 1e-300)
        found, _, rank, _ = np.linalg.lstsq(design / scale, data, rcond=1e-6)
        if rank < design.shape[1]:
            raise EstimationError(
                f"the stamps cannot separate a sine of {omega / (2 * np.pi):.5g} Hz from an offset; sample more than "
                "twice a period, or at other instants"
            )
        found = found / scale
        if is_frequency_free:
            step = float(found[3])
            omega += step
            converged = abs(step) * float(late[-1] - late[0]) < 1e-10
            if not omega > 0.0:
                raise EstimationError("the frequency ran below zero; start nearer, or give the frequency")
            if converged:
                break
    residuals = data - design @ found
    freedom = max(len(data) - design.shape[1], 1)
    variance = float(residuals @ residuals) / freedom
    scale = np.linalg.norm(design, axis=0)
    scaled = design / scale
    covariance = variance * np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale)
    # Back from the middle of the record to the times as given.
    turn = np.exp(-1j * omega * middle)
    amplitude = complex(found[0], found[1]) * turn
    rotation = np.eye(len(covariance))
    rotation[:2, :2] = [[turn.real, -turn.imag], [turn.imag, turn.real]]
    if is_frequency_free:
        rotation[:2, 3] = [middle * amplitude.imag, -middle * amplitude.real]
    return SineFit(
        omega=omega,
        amplitude=amplitude,
        offset=float(found[2]),
        covariance=rotation @ covariance @ rotation.T,
        noise_sd=math.sqrt(variance),
        n_samples=len(data),
        converged=converged,
    )


def stepped_sine_response(
    record: TimeRecord,
    frequencies_hz: FloatArray,
    starts_s: FloatArray,
    ends_s: FloatArray,
    input_name: str | None = None,
    output_names: Sequence[str] | None = None,
) -> FrequencyRecord:
    """Estimate a frequency response from a record in which sines were played one after another.

    Parameters
    ----------
    record : TimeRecord
        Outputs at any stamps; the input regular.
    frequencies_hz : ndarray, shape (n_steps,) -- what was played [Hz]
    starts_s, ends_s : ndarray, shape (n_steps,)
        The steady stretch of every step [s], transients left out.
    input_name : str or None -- which input, where there are several
    output_names : sequence of str or None -- None takes all

    Raises
    ------
    EstimationError
        Steps that do not match, too few samples in one, an input that does not move.

    Notes
    -----
    The variances take the residuals of every segment as white, and count the noise of the
    input where its samples scatter about its own sine.
    """
    require_record(record)
    hertz = finite_row("frequencies_hz [Hz]", frequencies_hz)
    starts, ends = finite_row("starts_s [s]", starts_s), finite_row("ends_s [s]", ends_s)
    if not (hertz.shape == starts.shape == ends.shape and len(hertz)):
        raise EstimationError(
            f"{hertz.shape} frequencies, {starts.shape} starts and {ends.shape} ends; expected one of each per step"
        )
    drive = chosen_input(record, input_name)
    period = drive.period_s
    if period is None:
        raise EstimationError(f"input {drive.name!r} has irregular stamps; its hold then has no single gain")
    outputs = [record.output(n) for n in (record.output_names if output_names is None else output_names)]
    response = np.empty((len(hertz), len(outputs)), dtype=np.complex128)
    covariance = np.empty((len(hertz), len(outputs), len(outputs)), dtype=np.complex128)
    fewest = math.inf
    rates: list[list[_Rate]] = [[] for _ in outputs]
    for k in range(len(hertz)):
        omega = 2.0 * np.pi * float(hertz[k])
        # Times from the segment's start: phases of long records would lose digits.
        origin = float(starts[k])
        is_driven = (drive.times_s >= starts[k]) & (drive.times_s <= ends[k])
        of_input = _segment(drive.name, drive.times_s[is_driven] - origin, drive.values[is_driven], omega)
        held = complex(hold_gain(drive.hold, np.array([omega]), period)[0])
        moved = of_input.amplitude * held
        if not abs(moved) > 1e-12 * float(np.max(np.abs(drive.values), initial=0.0)):
            raise EstimationError(
                f"input {drive.name!r} does not move at {hertz[k]:.5g} Hz from {starts[k]:.3f} s"
            )
        relative = of_input.amplitude_variance / abs(of_input.amplitude) ** 2
        for j, output in enumerate(outputs):
            within = (output.times_s >= starts[k]) & (output.times_s <= ends[k])
            require_output(output.name, output.values[within & output.is_valid])
            fit = _segment(output.name, output.times_s[within] - origin, output.values[within], omega)
            rates[j] += _rates(output, within, drive, is_driven, omega)
            gain = float(exposure_gain(np.array([omega]), output.exposure_s)[0]) * moved
            response[k, j] = fit.amplitude / gain
            covariance[k, j, j] = fit.amplitude_variance / abs(gain) ** 2
            fewest = min(fewest, 0.5 * (fit.n_samples - 3))
        covariance[k] += relative * np.outer(response[k], np.conj(response[k]))
    span_s = float(np.ptp(np.concatenate([starts, ends])))
    apart = [said for output, own in zip(outputs, rates, strict=True) for said in _apart(output, own, span_s)]
    order = np.argsort(hertz, kind="stable")
    made = FrequencyRecord(
        omegas=2.0 * np.pi * hertz[order],
        response=response[order],
        covariance=covariance[order],
        output_names=tuple(o.name for o in outputs),
        input_names=(drive.name,),
        output_units=tuple(o.unit for o in outputs),
        input_units=(drive.unit,),
        degrees_of_freedom=fewest,
        method=f"sine fits of {len(hertz)} steps",
        name=record.name,
    )
    return with_doubts(made, outputs, drive, apart)


@dataclass(frozen=True)
class _Rate:
    """By which share the frequency of an output's sine is another than that of its input's, in one step."""

    omega: float
    relative: float
    sd: float
    turned: float  # what that makes over the step [rad]


def _rates(
    output: OutputSignal, seen: BoolArray, drive: InputSignal, driven: BoolArray, omega: float
) -> list[_Rate]:
    """Return how the frequencies of an output's sine and its input's compare; nothing where one is no sine."""
    found = []
    for times, values in (
        (drive.times_s[driven], drive.values[driven]),
        (output.times_s[seen], output.values[seen]),
    ):
        try:
            found.append(fit_sine(times, values, omega, is_frequency_free=True))
        except EstimationError:
            return []  # the response's own variance says so
    of_input, of_output = found
    if not (of_input.converged and of_output.converged):
        return []
    difference = of_output.omega - of_input.omega
    spread = math.hypot(of_input.omega_sd, of_output.omega_sd) + _SAME * omega
    turned = abs(difference) * float(np.ptp(output.times_s[seen]))
    return [_Rate(omega, difference / of_input.omega, spread / of_input.omega, turned)]


def _apart(output: OutputSignal, rates: Sequence[_Rate], span_s: float) -> list[str]:
    """Return whether an output's sines have other frequencies than the input's, as only another clock gives them.

    Parameters
    ----------
    output : OutputSignal
    rates : sequence of _Rate -- of its steps
    span_s : float -- from the first step to the last [s]
    """
    said = [
        f"output {output.name!r}: the sine of {own.omega / (2.0 * np.pi):.5g} Hz has {own.relative:+.2%} "
        f"another frequency than the input's ({abs(own.relative) / own.sd:.0f} standard deviations): the clocks run "
        "at different rates. Give both the stamps of one clock"
        for own in rates
        if abs(own.relative) > _APART * own.sd and own.turned > _TURNED
    ]
    if said or len(rates) < _MIN_STEPS:
        return said
    # A transient pulls the frequency of each step elsewhere, a clock that of all steps alike.
    relative, sds = np.array([own.relative for own in rates]), np.array([own.sd for own in rates])
    weights = sds**-2.0 / np.sum(sds**-2.0)
    mean, formal = float(weights @ relative), float(np.sum(sds**-2.0)) ** -0.5
    freedom = len(rates) - 1
    scatter = formal * math.sqrt(float(np.sum(np.square((relative - mean) / sds))) / freedom)
    least = max(_APART * formal, -float(student_quantile(freedom, 0.5 * _CLOCK_LEVEL)) * scatter)
    if abs(mean) <= least or abs(mean) * max(own.omega for own in rates) * span_s <= _TURNED:
        return []
    return [
        f"output {output.name!r}: the sines of all {len(rates)} steps have {mean:+.3%} another frequency than "
        f"the input's ({abs(mean) / max(formal, scatter):.0f} standard deviations): the clocks run at different "
        "rates. Give both the stamps of one clock"
    ]


def _segment(name: str, times: FloatArray, values: FloatArray, omega: float) -> SineFit:
    try:
        return fit_sine(times, values, omega)
    except EstimationError as err:
        raise EstimationError(f"{name!r} at {omega / (2.0 * np.pi):.5g} Hz: {err}") from err
