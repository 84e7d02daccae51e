"""The local polynomial method: a frequency response from one record under any excitation.

The transient that leaks into every line is a smooth function of frequency and is estimated along
(Pintelon and Schoukens 2012, ch. 7).

Equation numbers are those of docs/frequency-equations.md.
"""

from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.data.argument_checks import require_whole_number
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.responses.signal_pair import LineEstimate, SignalPair, for_every_output
from beam_ident.responses.steady_periods import SHARED_BY_HANN, stretch_omegas, stretches

_MAX_DEGREE = 10  # of local polynomials: beyond it their powers are alike
_RCOND = 1e-10
_LOST_POWER = 0.01  # of the input's: where less of it cannot be told, nothing is said
_NAMED_STRETCHES = 3  # in a warning, the longest
_MAX_INFLATION = 10.0  # of a variance by collinear columns: Marquardt (1970), Technometrics 12, 591-612


def local_polynomial_response(
    record: TimeRecord,
    degree: int = 2,
    half_width: int | None = None,
    output_names: Sequence[str] | None = None,
    input_name: str | None = None,
) -> FrequencyRecord:
    """Estimate a frequency response and the leaking transient by local polynomials.

    Parameters
    ----------
    record : TimeRecord
    degree : int -- of both polynomials
    half_width : int or None
        Lines on either side; None takes the least that leaves as many degrees of freedom
        as there are unknowns.
    output_names : sequence of str or None -- None takes all, which then share their stamps
    input_name : str or None -- which input, where there are several

    Raises
    ------
    EstimationError
        Irregular stamps, a record too short for the polynomials, an input or output that is constant.

    Notes
    -----
    The polynomials must be able to follow the resonances: at damping ratio zeta and
    frequency f the half-power band is 2 zeta f wide and should hold several lines
    (line spacing is one over the length of the record).  Neighbouring lines share data, so
    that their errors depend on each other.  Lines at which the transient's columns inflate the
    variance of the response more than tenfold are marked as not measured (NaN): there the input is
    as smooth over frequency as the transient, and a polynomial that does not quite follow
    a resonance is wrong many times over.
    """
    require_whole_number("degree", degree, 0, _MAX_DEGREE)
    unknowns = 2 * (degree + 1)
    width = unknowns if half_width is None else half_width
    if 2 * width + 1 <= unknowns:
        raise EstimationError(f"half_width is {width}; degree {degree} needs at least {unknowns // 2 + 1}")

    def estimate(pair: SignalPair) -> LineEstimate:
        return _local_polynomial(pair, degree, width)

    method = f"local polynomial of degree {degree} over {2 * width + 1} lines"
    return for_every_output(record, output_names, input_name, None, method, estimate)


def _local_polynomial(pair: SignalPair, degree: int, width: int) -> LineEstimate:
    n = len(pair.output)
    # Offsets would leak into the lowest lines; without them the transient is smooth there, too.
    of_input = np.fft.rfft(pair.drive - np.mean(pair.drive)) / np.sqrt(n)
    of_output = np.fft.rfft(pair.output - np.mean(pair.output)) / np.sqrt(n)
    lines = np.arange(1, len(of_input) - (1 - n % 2))
    if len(lines) < 2 * width + 1:
        raise EstimationError(
            f"{len(lines)} lines in the record; half_width {width} needs at least {2 * width + 1}"
        )
    # At the ends of the band the window stays inside, with the line off its middle.
    centres = np.clip(lines, 1 + width, lines[-1] - width)
    around = centres[:, None] + np.arange(-width, width + 1)
    distance = (around - lines[:, None]) / width
    powers = distance[:, :, None] ** np.arange(degree + 1)
    u, y = of_input[around], of_output[around]
    # (F.6): columns of h_0, h_1 .. and of t_0, t_1 .., line by line.
    matrix = np.concatenate([powers * u[:, :, None], powers.astype(np.complex128)], axis=2)
    size = np.linalg.norm(matrix, axis=1, keepdims=True)
    matrix = matrix / np.where(size > 0.0, size, 1.0)
    inverse = np.linalg.pinv(matrix, rcond=_RCOND)
    found = np.einsum("kij,kj->ki", inverse, y)
    residual = y - np.einsum("kij,kj->ki", matrix, found)
    freedom = 2 * width + 1 - 2 * (degree + 1)
    variance = np.sum(np.abs(residual) ** 2, axis=1) / freedom
    scale = np.where(size[:, 0, 0] > 0.0, size[:, 0, 0], np.inf)
    # The variance of h_0 under white noise: the row of the pseudo-inverse that gives it, squared.
    gain = np.sum(np.abs(inverse[:, 0, :]) ** 2, axis=1)
    alone = np.linalg.pinv(matrix[:, :, : degree + 1], rcond=_RCOND)[:, 0, :]
    told = gain <= _MAX_INFLATION * np.sum(np.abs(alone) ** 2, axis=1)
    omegas = np.asarray(2.0 * np.pi * lines / (n * pair.period), dtype=np.float64)
    if not np.any(told):
        raise EstimationError(
            "the input comes in the record's first or last moments only, and its response cannot be told from the "
            "transient of the record's ends. Begin the record earlier or end it later, or fit samples, identify(), "
            "which takes the record as it is; hammer_response() takes blows"
        )
    response = np.where(told, found[:, 0] / scale, np.nan)
    seen = np.zeros(len(of_output), dtype=np.complex128)
    seen[lines[told]] = of_output[lines[told]]
    spectrum = np.zeros(len(of_input), dtype=np.complex128)
    spectrum[lines[told]] = response[told] * of_input[lines[told]]
    measured, modelled = (np.fft.irfft(one, n) * np.sqrt(n) for one in (seen, spectrum))
    return LineEstimate(
        omegas,
        response,
        np.where(told, variance * gain / scale**2, np.nan),
        None,
        float(freedom),
        (stretches(modelled), stretches(measured), stretch_omegas(n, pair.period), SHARED_BY_HANN, True),
        _reach(degree, width),
        measured - modelled,
        _untold(omegas, np.abs(of_input[lines]) ** 2, told),
        (2 * width + 1) / (n * pair.period),
    )


def _untold(omegas: FloatArray, power: FloatArray, told: BoolArray) -> tuple[str, ...]:
    """Return what is to be known of lines at which the response cannot be told from the transient.

    Parameters
    ----------
    omegas, power : ndarray, shape (n_lines,) -- power of the input; lines that hold none of it are nobody's loss
    told : ndarray of bool, shape (n_lines,)
    """
    share = float(np.sum(power[~told]) / np.sum(power))
    if share < _LOST_POWER:
        return ()
    starts, ends = np.flatnonzero(np.diff(np.concatenate([[1], told, [1]]).astype(int))).reshape(-1, 2).T
    longest = np.sort(np.argsort(starts - ends, kind="stable")[:_NAMED_STRETCHES])
    frequencies = omegas / (2.0 * np.pi)
    bands = [f"{frequencies[starts[k]]:.4g} to {frequencies[ends[k] - 1]:.4g} Hz" for k in longest]
    if len(starts) > len(bands):
        bands.append("..")
    return (
        f"at {np.count_nonzero(~told)} of {len(told)} lines with {share:.0%} of its power ({', '.join(bands)}) "
        "the input comes only as the record begins or ends, as a sweep does, and its response cannot be told from "
        "the transient of the record's ends: they are marked as not measured. Begin the record earlier or end it "
        "later, take whole periods, or fit samples, identify()",
    )


def _reach(degree: int, width: int) -> float:
    """Return the sum of the correlations of a line's error with all lines, 1 / h'h for a smoother of weights h."""
    powers = (np.arange(-width, width + 1.0) / width)[:, None] ** np.arange(degree + 1)
    weights = np.linalg.pinv(powers)[0]
    return max(1.0 / float(weights @ weights), 1.0)
