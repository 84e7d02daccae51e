"""Responses from the steady periods of a periodic excitation, each line with its noise.

Over whole periods a Fourier transform leaks nothing: an excited line holds the response,
the scatter from period to period is the noise, and lines that were not excited show
distortion (Pintelon and Schoukens 2012, ch. 2 and 4).  Where the input is measured and noisy
itself, the response is the ratio of the averaged spectra, and its variance counts the
noise of both and what they have in common (errors in variables):

    var H = |H|^2 [ var Y / |Y|^2 + var U / |U|^2 - 2 Re( cov(Y, U) / (Y conj U) ) ]

Input and outputs keep their own clocks (``periods``).  An output sampled slower than twice the
highest line folds it, and every line is reported at the frequency that was excited, above
half the output's rate too.  What else falls on a line stands in its ``Folding``.

Equation numbers are those of docs/frequency-equations.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import BoolArray, ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import chosen_input, require_record
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.responses.doubts import with_doubts
from beam_ident.responses.periods import (
    ENOUGH_FREEDOM,
    ExcitedLines,
    PeriodicInput,
    SteadyPeriods,
    angular,
    excited_numbers,
    exposure_gain,
    moving_mean,
)
from beam_ident.responses.steady_periods import (
    changing_warnings,
    drift_of_periods,
    input_changes,
    unsteady_warnings,
)


@dataclass(frozen=True, eq=False)
class PeriodicResponse:
    """A frequency response from periods, and the outputs' whole spectra.

    Attributes
    ----------
    response : FrequencyRecord -- at the excited lines
    n_periods : int
    line_period_s : float
    bins : ndarray, shape (n_bins,) -- lines below half the outputs' rate, as multiples of 1 / line_period_s
    spectrum : complex ndarray, shape (n_bins, n_outputs)
        Amplitude (peak of the sine) of the outputs' mean period.
    spectrum_variance : ndarray, shape (n_bins, n_outputs)
        ``E |error|^2`` of a single period's amplitude, from the scatter between periods.
    input_spectrum : complex ndarray, shape (n_bins,) -- amplitude of the input as the outputs sample it
    is_excited : ndarray of bool, shape (n_bins,) -- whether an excited line, or its fold, stands there
    drift : ndarray, shape (n_outputs,)
        Power of the change from the first period to the last over what the noise between
        other periods explains; about 1 when steady, NaN for fewer than three periods.  Where noise does
        not explain it, the response says so in its ``warnings``, and every fit to it too.
    first_s : float -- when the first period begins [s]
    is_shared : ndarray of bool, shape (n_lines,) -- whether another excited line falls onto the same line
    line_outputs : complex ndarray, shape (n_outputs, n_periods, n_lines)
        Two-sided Fourier coefficients of every period at the lines of the response.
    line_inputs : complex ndarray, shape (n_periods, n_lines) -- of the input, as the outputs sample it
    bin_outputs, bin_inputs : complex ndarray, shape (n_outputs, n_periods, n_bins) and (n_periods, n_bins)
        The same at all bins.
    """

    response: FrequencyRecord
    n_periods: int
    line_period_s: float
    bins: IndexArray
    spectrum: ComplexArray
    spectrum_variance: FloatArray
    input_spectrum: ComplexArray
    is_excited: BoolArray
    drift: FloatArray
    first_s: float
    is_shared: BoolArray
    line_outputs: ComplexArray
    line_inputs: ComplexArray
    bin_outputs: ComplexArray
    bin_inputs: ComplexArray

    @property
    def bins_hz(self) -> FloatArray:
        """Frequencies of the bins [Hz]."""
        return np.asarray(self.bins / self.line_period_s)


def periodic_response(
    record: TimeRecord,
    line_period_s: float,
    excited_hz: FloatArray | None = None,
    start_s: float = -np.inf,
    end_s: float = np.inf,
    output_names: Sequence[str] | None = None,
    input_name: str | None = None,
) -> PeriodicResponse:
    """Estimate a frequency response from the steady periods of a periodic excitation.

    Parameters
    ----------
    record : TimeRecord
        Outputs at any stamps, a regular input. Lines above half the outputs' rate need common regular stamps.
    line_period_s : float
        Period of the excitation [s]; a whole number of samples of the outputs, where lines lie above half their rate.
    excited_hz : ndarray or None
        Its lines [Hz]; None takes the lines whose input stands out.
    start_s, end_s : float
        The steady part [s], with at least two whole periods.
    output_names : sequence of str or None -- None takes all
    input_name : str or None -- which input, where there are several

    Raises
    ------
    EstimationError
        An irregular input, lines that the stamps do not carry, fewer than two periods without a hole.

    Notes
    -----
    The noise's covariance is averaged over neighbouring lines until it has some forty
    degrees of freedom, because weights from two or three periods alone would cost much
    of the accuracy of a fit; this takes the noise of input and outputs, not the
    response, to be smooth over a few lines. A period with a hole in its samples, longer than half a period of the
    highest line, is left out.
    """
    require_record(record)
    drive = chosen_input(record, input_name)
    outputs = [record.output(n) for n in (record.output_names if output_names is None else output_names)]
    if not outputs:
        raise EstimationError(f"no output is named; expected some of {', '.join(record.output_names)}")
    if len({o.exposure_s for o in outputs}) > 1:
        raise EstimationError(
            f"outputs {', '.join(o.name for o in outputs)} have different exposures; estimate them one at a time, "
            "with output_names"
        )
    exposure_s = outputs[0].exposure_s
    half = 0.5 * exposure_s
    first, last = drive.span_s
    steady = SteadyPeriods.of(outputs, line_period_s, max(start_s, first + half), min(end_s, last - half))
    source = PeriodicInput.of(drive, steady.first_s, steady.n_periods, line_period_s, half)
    numbers = excited_numbers(source, excited_hz, line_period_s)
    every = steady.spectra(int(np.max(numbers)))
    # Two-sided Fourier coefficients of every period, referred to the first stamp.
    spectra, kept = source.known(every.values, every.kept)
    source, n_periods = source.only(kept), len(kept)
    bins = np.arange(1, spectra.shape[2] + 1)
    lines = ExcitedLines.of(source, numbers, every.per_period, line_period_s, exposure_s)
    at = lines.bins - 1
    # A bin above half the rate holds the conjugate of the line that folded there.
    measured = np.where(lines.sign > 0, spectra[:, :, at], np.conj(spectra[:, :, at]))
    of_input = lines.input_of(source, exposure_s, line_period_s)
    drives = np.stack([of_input] * len(outputs))
    mean_y, mean_u = np.mean(measured, axis=1), np.mean(drives, axis=1)
    # (F.1); noise on the input averages out before the division and does not bias it.
    response = mean_y / mean_u
    covariance, freedom = _covariance(measured - mean_y[:, None], drives - mean_u[:, None], response, mean_u)
    scatter = np.sum(np.abs(spectra - np.mean(spectra, axis=1)[:, None]) ** 2, axis=1) / (n_periods - 1)
    quiet = source.quiet(numbers)
    # What a period has at a bin, and what folds there from the mean period's images.
    exposed = exposure_gain(angular(bins, line_period_s), exposure_s)
    seen = own = quiet.coefficients(bins, line_period_s)[0] * exposed
    folding = None
    if every.per_period is not None:
        own_times = np.asarray(
            line_period_s / every.per_period * np.arange(every.per_period), dtype=np.float64
        )
        integrals = quiet.integrals(own_times, exposure_s)
        # The sums over all images behind (F.5), from the held input's derivatives and integrals.
        sampled = [np.fft.fft(part)[bins] / every.per_period for part in integrals]
        seen = sampled[2]
        folding = lines.folding(quiet, sampled, every.per_period, line_period_s, exposure_s)
    bin_inputs = source.coefficients(bins, line_period_s) * exposed + (seen - own)
    drift, is_unsteady = drift_of_periods(spectra)
    has_input_changed = input_changes(source.ticks)
    found = FrequencyRecord(
        omegas=lines.omegas,
        response=response.T,
        covariance=covariance,
        output_names=tuple(o.name for o in outputs),
        input_names=(drive.name,),
        output_units=tuple(o.unit for o in outputs),
        input_units=(drive.unit,),
        degrees_of_freedom=freedom,
        method=f"mean of {n_periods} periods",
        folding=folding,
        name=record.name,
        warnings=unsteady_warnings(record.name, has_input_changed, drift[is_unsteady]),
    )
    changes = [
        said
        for output, own, line, u in zip(outputs, measured, response, drives, strict=True)
        for said in changing_warnings(output.name, line * u, own, lines.omegas, leaks=True)
    ]
    is_excited = np.zeros(len(bins), dtype=bool)
    is_excited[lines.every[lines.every <= len(bins)] - 1] = True
    return PeriodicResponse(
        response=with_doubts(found, outputs, drive, () if has_input_changed else changes),
        n_periods=n_periods,
        line_period_s=line_period_s,
        bins=bins,
        spectrum=2.0 * np.mean(spectra, axis=1).T,
        spectrum_variance=4.0 * scatter.T,
        input_spectrum=2.0 * seen,
        is_excited=is_excited,
        drift=drift,
        first_s=steady.first_s,
        is_shared=lines.is_shared,
        line_outputs=measured,
        line_inputs=of_input,
        bin_outputs=spectra,
        bin_inputs=bin_inputs,
    )


def _covariance(
    of_outputs: ComplexArray, of_inputs: ComplexArray, response: ComplexArray, mean_u: ComplexArray
) -> tuple[ComplexArray, float]:
    """Return the response's covariance by line, shape (n_lines, n_outputs, n_outputs), and its freedom."""
    n_outputs, n_periods, n_lines = of_outputs.shape
    # Sigma and J of (F.2), over outputs and, for each, the input as it sees it.
    together = np.concatenate([of_outputs, of_inputs], axis=0)
    second = np.einsum("apl,bpl->lab", together, np.conj(together)) / (n_periods - 1)
    width = int(min(np.ceil(ENOUGH_FREEDOM / (n_periods - 1)), n_lines))
    smooth = moving_mean(second, width)
    jacobian = np.zeros((n_lines, n_outputs, 2 * n_outputs), dtype=np.complex128)
    index = np.arange(n_outputs)
    jacobian[:, index, index] = 1.0 / mean_u.T
    jacobian[:, index, n_outputs + index] = -(response / mean_u).T
    covariance = jacobian @ smooth @ np.conj(np.swapaxes(jacobian, 1, 2)) / n_periods
    return without_negative(covariance), float(width * (n_periods - 1))


def without_negative(covariance: ComplexArray) -> ComplexArray:
    """Return covariances, shape (n_lines, n, n), without what rounding makes of a variance of zero."""
    found = np.array(covariance)
    index = np.arange(found.shape[1])
    found[:, index, index] = np.maximum(found[:, index, index].real, 0.0)
    return found
