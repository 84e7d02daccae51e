"""The best linear approximation of a system that may be nonlinear, from realisations of a periodic random input.

M realisations of a multisine, each of P periods, tell three things apart at every line.  The response that is common
to all realisations is the best linear approximation.  What the periods of one realisation differ by is noise.  What
the means of the realisations differ by beyond that noise is the stochastic part of the nonlinear distortion: with
other phases it is another one (Pintelon and Schoukens 2012, ch. 4, the robust method).  Lines that a realisation
does not excite show the same distortion as even and as odd.

In a loop the distortion comes back through the input, and the input is correlated with it.  Correlation with a
reference that is none of the loop's own signals removes that, and the noise of a measured input as well.

Equation numbers are those of docs/frequency-equations.md.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import fdtrc as f_sf

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.best_linear.realisations import (
    Realisations,
    chosen_input_name,
    line_numbers,
    lines_of_each,
    realisations_of,
    require_differences,
    require_repetition,
    settled_responses,
    side_by_side,
    unsteadiness,
)
from beam_ident.best_linear.result import BestLinearApproximation, LineVariances
from beam_ident.data.frequency_record import Folding
from beam_ident.data.records import TimeRecord
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.responses.detection_lines import (
    NonlinearDistortion,
    detection_lines,
    nonlinear_distortion,
    periods_without_input,
)
from beam_ident.responses.periodic_averaging import (
    PeriodicResponse,
    periodic_response,
    without_negative,
)
from beam_ident.responses.periods import mean_of_neighbours

_SIGNIFICANCE = 0.01  # chance that a linear system is called nonlinear, by the excited or by the other lines
_KNOWN = 1e-6  # of an input: what scatters less was not measured
_ROUNDING = 1e-9  # of a response: noise that is less counts as so much
_SEEN = 2.0  # real degrees of freedom of a complex value
_LEVELS = 1.5  # times the power: realisations that differ by more are not of one kind
_FEW = 4  # realisations: with fewer the total variance is hardly known
_SMOOTHING = 400.0  # degrees of freedom of the noise level that weighs lines in the test


@on_one_thread
def best_linear_approximation(
    records: TimeRecord | Sequence[TimeRecord],
    line_period_s: float,
    excited_hz: FloatArray | Sequence[FloatArray] | None = None,
    windows_s: Sequence[tuple[float, float]] | None = None,
    skip_periods: int | None = None,
    output_names: Sequence[str] | None = None,
    input_name: str | None = None,
    reference_name: str | None = None,
) -> BestLinearApproximation:
    """Estimate the best linear approximation, and tell noise from nonlinear distortion line by line.

    Parameters
    ----------
    records : TimeRecord or sequence of TimeRecord
        One for each realisation, or a single one that holds them all.
    line_period_s : float -- period of the excitation [s]
    excited_hz : ndarray, sequence of M ndarrays, or None
        The excited lines [Hz], the same for all realisations or of each; None takes those that stand out of the
        reference, or of the input.
    windows_s : sequence of (start, end), optional
        Where the realisations are [s]: one window for each record, or all those of a single record.
    skip_periods : int or None
        Periods left out at the beginning of each realisation, while the system settles. None leaves out one where
        there are three or more, and more as long as the periods still change by more than their noise.
    output_names : sequence of str or None -- None takes all
    input_name : str or None -- which input, where there are several beside the reference
    reference_name : str or None
        The input that is known and none of a loop's own signals, as the command of a servo. Without one the input
        must be none either.

    Returns
    -------
    BestLinearApproximation

    Raises
    ------
    EstimationError
        One realisation only, or the same one twice; one period only; an input that does not repeat; lines that are
        excited in one realisation only; whatever ``periodic_response`` refuses.

    Notes
    -----
    With M realisations every line has 2 (M - 1) real degrees of freedom of the total variance, and those of the noise
    are 2 M (P - 1). Seven realisations of two periods tell more than two of seven (Pintelon and Schoukens 2012,
    sec. 4.3). All realisations must have one amplitude spectrum: the approximation depends on it.
    """
    parts = realisations_of(records, windows_s)
    name = chosen_input_name(parts[0][0], input_name, reference_name)
    lines = lines_of_each(excited_hz, len(parts))
    driver = name if reference_name is None else reference_name
    skipped, found = settled_responses(parts, line_period_s, lines, skip_periods, output_names, driver)
    references = found
    if reference_name is not None:
        excited = [own.response.frequencies_hz for own in references]
        found = [
            periodic_response(record, line_period_s, own, one.first_s - 1e-6, end_s, output_names, name)
            for (record, _, end_s), own, one in zip(parts, excited, references, strict=True)
        ]
    require_repetition(references)
    require_differences(references)
    data = side_by_side(found, references)
    return _approximation(data, skipped, name, reference_name or "")


def _approximation(
    data: Realisations, skipped: int, name: str, reference_name: str
) -> BestLinearApproximation:
    first = data.found[0].response
    M = np.sum(data.is_excited, axis=0)
    mask = data.is_excited[:, :, None, None]
    more = np.sum(data.is_excited * (data.n_periods - 1)[:, None], axis=0)
    # Noise of one period, pooled, and of a realisation's mean.
    of_period = np.sum(data.scatter, axis=0) / more[:, None, None]
    shares = np.sum(mask / data.n_periods[:, None, None, None], axis=0)
    of_mean = of_period * shares / M[:, None, None]
    # (F.7): correlation with the reference; without one, with the input itself less the power of its noise.
    above = np.einsum("mjl,ml->lj", data.outputs, np.conj(data.instruments))
    below = np.einsum("ml,ml->l", data.inputs, np.conj(data.instruments))
    if not reference_name:
        above = above - M[:, None] * of_mean[:, :-1, -1]
        below = below - M * of_mean[:, -1, -1]
    response = above / below[:, None]
    left = (data.outputs - response.T * data.inputs[:, None]) * data.is_excited[:, None]
    total = np.einsum("mil,mjl->lij", left, np.conj(left)) / (M - 1)[:, None, None]
    # (F.8): noise of y - G u, from the scatter of both.
    jacobian = np.concatenate(
        [
            np.broadcast_to(np.eye(response.shape[1]), (len(M), response.shape[1], response.shape[1])),
            -response[:, :, None],
        ],
        axis=2,
    )
    noise = without_negative(jacobian @ of_mean @ np.conj(np.swapaxes(jacobian, 1, 2)))
    # (F.9): what an error of y - G u makes of G.
    gain = np.sum(np.abs(data.instruments) ** 2, axis=0) / np.abs(below) ** 2
    total, noise = total * gain[:, None, None], noise * gain[:, None, None]
    omegas = np.asarray(2.0 * np.pi * data.numbers / data.found[0].line_period_s, dtype=np.float64)
    excited = LineVariances(
        omegas,
        np.einsum("ljj->lj", total).real * M[:, None],
        np.einsum("ljj->lj", noise).real * M[:, None],
        _SEEN * (M - 1.0),
        _SEEN * more,
    )
    power = np.asarray(1.0 / (M * gain))
    even, odd = (_at_rest(data, response, power, parity) for parity in (0, 1))
    own = 0.5 * _SIGNIFICANCE if even or odd else _SIGNIFICANCE
    judged = nonlinear_distortion(data.found, own) if even or odd else None
    p_value = _p_value(excited, response)
    return BestLinearApproximation(
        omegas=omegas,
        response=response,
        total_covariance=total,
        noise_covariance=noise,
        n_realisations=M,
        n_periods=tuple(int(own) for own in data.n_periods),
        skipped_periods=skipped,
        excited=excited,
        even=even,
        odd=odd,
        input_power=power,
        distortion=judged,
        p_value=p_value,
        verdict=_verdict(excited, response, power, p_value < own, judged),
        input_name=name,
        reference_name=reference_name,
        input_unit=first.input_units[0],
        output_names=tuple(first.output_names),
        output_units=tuple(first.output_units),
        line_period_s=data.found[0].line_period_s,
        folding=_folding(data),
        name=first.name,
        warnings=(*_warnings(data, excited, response, reference_name, name), *_said(data.found)),
    )


def _at_rest(
    data: Realisations, response: ComplexArray, power: FloatArray, parity: int
) -> LineVariances | None:
    """Return what stands on the detection lines of one parity, as variances of the response; None without any.

    What the input has there is taken away through the response of all realisations: that of a single one has its
    distortion in it. The power of the input is what stands behind the response at the lines on either side, so that
    these variances and those of the excited lines are of one kind.
    """
    found = data.found
    sums: dict[int, list[Any]] = {}
    n_outputs = found[0].line_outputs.shape[0]
    for one in found:
        lines = detection_lines(one)
        lines = lines[one.bins[lines] % 2 == parity]
        if not len(lines):
            continue
        own = data.numbers <= len(one.bins)
        known = [(data.numbers[own] - 1, response[own, j]) for j in range(n_outputs)]
        amplitudes = np.stack(
            [periods_without_input(one, j, lines, known[j]) for j in range(n_outputs)], axis=2
        )
        mean = np.mean(amplitudes, axis=0)
        squares = np.sum(np.abs(amplitudes - mean) ** 2, axis=0)
        size = 4.0 * np.interp(one.bins[lines], data.numbers, power)  # amplitudes are peaks of sines
        for k, line in enumerate(lines):
            row = sums.setdefault(int(one.bins[line]), [0.0, 0.0, 0, 0, 0.0])
            row[0] += np.abs(mean[k]) ** 2 / size[k]
            row[1] += squares[k] / size[k]
            row[2] += 1
            row[3] += one.n_periods - 1
            row[4] += 1.0 / one.n_periods
    if not sums:
        return None
    numbers = sorted(sums)
    rows = [sums[number] for number in numbers]
    total = np.array([row[0] / row[2] for row in rows])
    noise = np.array([row[1] / row[3] * row[4] / row[2] for row in rows])
    return LineVariances(
        np.asarray(2.0 * np.pi * np.array(numbers, dtype=np.float64) / found[0].line_period_s),
        total,
        noise,
        np.array([_SEEN * row[2] for row in rows], dtype=np.float64),
        np.array([_SEEN * row[3] for row in rows], dtype=np.float64),
    )


def _folding(data: Realisations) -> Folding | None:
    """Return what else falls on every line, as the first realisation that excites it has it."""
    own = [one.response.folding for one in data.found]
    known = [fold for fold in own if fold is not None]
    if len(known) < len(own):
        return None
    width = max(fold.omegas.shape[1] for fold in known)
    omegas = np.repeat(2.0 * np.pi * data.numbers[:, None] / data.found[0].line_period_s, width, axis=1)
    weights = np.zeros(omegas.shape, dtype=np.complex128)
    tails = np.zeros((len(omegas), known[0].tails.shape[1]), dtype=np.complex128)
    chosen = np.argmax(data.is_excited, axis=0)
    for m, fold in enumerate(known):
        here = np.flatnonzero(chosen == m)
        at = np.searchsorted(line_numbers(data.found[m]), data.numbers[here])
        n = fold.omegas.shape[1]
        omegas[here, :n], weights[here, :n], tails[here] = fold.omegas[at], fold.weights[at], fold.tails[at]
    return Folding(omegas, weights, tails)


def _p_value(excited: LineVariances, response: ComplexArray) -> float:
    """Return the chance that noise alone makes realisations differ as much, over all lines and outputs."""
    of_total, of_noise = excited.total_freedom[:, None], excited.noise_freedom[:, None]
    width = int(np.ceil(_SMOOTHING / float(np.min(of_noise))))
    floor = _ROUNDING**2 * np.mean(np.abs(response) ** 2, axis=0) + 1e-300
    level = np.maximum(mean_of_neighbours(excited.noise, width), floor)
    above = np.sum(of_total * excited.total / level, axis=0) / np.sum(of_total)
    # Without noise, what is left by rounding is no distortion.
    below = np.sum(of_noise * np.maximum(excited.noise, floor) / level, axis=0) / np.sum(of_noise)
    chances = f_sf(np.sum(of_total), np.sum(of_noise), above / below)
    return float(min(1.0, len(above) * np.min(chances)))


def _verdict(
    excited: LineVariances,
    response: ComplexArray,
    power: FloatArray,
    is_apart: bool,
    judged: NonlinearDistortion | None,
) -> str:
    """Return what the variances say, where realisations differ beyond their noise (``is_apart``) or not."""
    whole = np.sum(np.abs(response) ** 2 * power[:, None], axis=0)
    distortion, noise = (
        np.sum(values * power[:, None], axis=0) / whole
        for values in (excited.total - excited.noise, excited.noise)
    )
    worst = int(np.argmax(distortion))
    decibel = 10.0 * np.log10(max(noise[worst], _ROUNDING**2))
    of_noise = f"the noise of a realisation, {decibel:.0f} dB of the response"
    if not is_apart and judged is not None and judged.is_nonlinear:
        said = f"nonlinear by less than {of_noise}: only the lines that were not excited show it"
    elif not is_apart:
        said = f"linear as far as {of_noise}, shows: realisations differ by no more than that"
    elif distortion[worst] > 0.0:
        said = f"nonlinear: distortion of {10.0 * np.log10(distortion[worst]):.0f} dB beside {of_noise}"
    else:
        said = f"nonlinear at some lines, with distortion that is less over all than {of_noise}"
    return said if judged is None else f"{said}; on the detection lines {judged.verdict}"


def _warnings(
    data: Realisations, excited: LineVariances, response: ComplexArray, reference_name: str, name: str
) -> tuple[str, ...]:
    said = []
    own_scatter = np.einsum("mlaa->mla", data.scatter).real[:, :, -1]
    measured = float(np.sum(own_scatter)) > _KNOWN**2 * float(np.sum(np.abs(data.inputs) ** 2))
    if measured and not reference_name:
        said.append(
            f"the input {name!r} differs from period to period, so it was measured: if a loop closes through it, "
            "distortion comes back with it, and the response is biased. Give the command as reference_name"
        )
    if drift := unsteadiness(data.found):
        said.append(
            f"the periods still change (drift {drift:.3g}; about 1 where they are steady): a transient that has not "
            "died out counts as noise and hides distortion. Record more periods than the system takes to settle"
        )
    if len(data.found) < _FEW:
        said.append(
            f"{len(data.found)} realisations leave {2 * (len(data.found) - 1)} degrees of freedom to the total "
            "variance of a line: its bands are wide. Record seven or more"
        )
    lost = np.any(excited.total > np.abs(response) ** 2, axis=1)
    if np.any(lost):
        said.append(
            f"at {np.count_nonzero(lost)} of {len(lost)} lines, between {excited.frequencies_hz[lost][0]:.4g} and "
            f"{excited.frequencies_hz[lost][-1]:.4g} Hz, realisations differ by more than the response itself: it "
            "means little there, and bands hold less often than they state. Excite these lines more"
        )
    sizes = np.array(
        [
            np.sum(np.abs(own[here]) ** 2) / max(np.count_nonzero(here), 1)
            for own, here in zip(data.instruments, data.is_excited, strict=True)
        ]
    )
    if np.max(sizes) > _LEVELS * np.min(sizes):
        said.append(
            f"the power of the realisations differs by a factor of {np.max(sizes) / np.min(sizes):.2f}: a best "
            "linear approximation depends on the level, and what is given is a mean. Excite all of them alike"
        )
    return tuple(said)


def _said(found: Sequence[PeriodicResponse]) -> tuple[str, ...]:
    """Return what the realisations warn of, each kind once."""
    kinds: dict[str, list[str]] = {}
    for one in found:
        for said in one.response.warnings:
            kinds.setdefault(re.sub(r"[-+.e\d]+", "", said), []).append(said)
    return tuple(
        own[0] if len(own) == 1 else f"{own[0]} (and alike in {len(own) - 1} more realisations)"
        for own in kinds.values()
    )
