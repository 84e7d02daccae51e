"""What a sensor's steps and ends do to its values: rounding, and clipping.

Rounding to steps of q adds an error of deviation ``q / sqrt(12)``.  Noise of half a step or more before it
makes that error independent of the signal to a percent (Widrow and Kollar, Quantization Noise, 2008, ch. 4): then it
is noise like any other, and least squares stays right.  With noise of sigma the mean error at y is, in first order,
``(q / pi) exp(-2 pi^2 (sigma / q)^2) sin(2 pi y / q)``: with less noise errors follow the signal, and samples weigh
by the likelihood of their intervals (``noise.rounding``).

Clipped samples stand at the end of the range, one after the other, where a model without them goes on beyond it.
What is left out is decided by that model, not by the samples: else the noise would choose.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import IdentificationError
from beam_ident.noise.record_fit import RecordFit
from beam_ident.noise.rounding import DITHER, dither, quantum

_CLIPPED, _IN_A_ROW = 5, 3  # samples at an end of the range
_PILE = 2.5  # times as many as at the level before: a sine that is only rounded has 2.4 at most
_BEYOND = 2.0  # standard deviations by which the model must pass the end on average
_MIN_BEYOND = 1e-6  # of the output's size: less is rounding
_COARSE = 1000.0  # steps in the whole swing: with more, errors are below 0.03 % of it
_MIN_SAMPLES = 32  # samples whose differences tell noise
_NEAR = 3.0  # standard deviations before the end, where noise may have been clipped

_FORCE_UNITS = ("N", "mN", "kN")

FitT = TypeVar("FitT")


def rounding_warning(outputs: Sequence[tuple[str, Sequence[RecordFit]]]) -> str:
    """Return what was done about outputs whose rounding errors follow the signal, or an empty string.

    Parameters
    ----------
    outputs : sequence of (name, records) -- of every output
    """
    weighed, found = [], []
    for name, records in outputs:
        for own in records:
            step = quantum(own.measured)
            if not step:
                continue
            if "rounding" in own.noise:
                weighed.append(f"{name} was taken for {own.noise}")
                break
            noise = dither(own.residuals, step)
            if noise < DITHER and float(np.std(own.residuals)) > 0.05 * step:
                found.append(f"{name} (steps of {step:.3g}, noise of {noise:.2g} steps)")
                break
    said = []
    if weighed:
        said.append(
            f"Rounding: {'; '.join(weighed)}: with noise of less than {DITHER} steps its errors follow the signal."
        )
    if found:
        said.append(
            f"Rounding: {', '.join(found)}. With noise of less than {DITHER} steps its errors follow the "
            "signal and may bias the fit by as much as their own deviation, 0.29 steps; standard deviations take "
            "them to be noise. Choose a finer range, or let half a step of noise in before the rounding."
        )
    return " ".join(said)


@dataclass(frozen=True)
class _End:
    """An end of an output's range at which samples of a record stand: 1 above, -1 below."""

    record: int
    name: str
    limit: float
    side: float

    def beyond(self, values: FloatArray) -> FloatArray:
        return np.asarray(self.side * (values - self.limit))


def without_clipped(
    records: list[TimeRecord],
    names: Sequence[str],
    fit: Callable[[list[TimeRecord]], FitT],
    predict: Callable[[FitT, TimeRecord, str], FloatArray],
) -> tuple[FitT, str]:
    """Return a fit without the samples that are clipped, and what must be known of them.

    Parameters
    ----------
    records : list of TimeRecord
    names : sequence of str -- of the outputs that are fitted
    fit : callable -- of records
    predict : callable
        Of a fit, a record and the name of an output: what the model says at all stamps, NaN where it does not.
    """
    ends = [
        end for index, record in enumerate(records) for name in names for end in _ends(record, index, name)
    ]
    if not ends:
        return fit(records), ""
    at_ends = [
        (end, np.asarray(end.beyond(records[end.record].output(end.name).values) >= 0.0)) for end in ends
    ]
    try:
        tried_records = _left_out(records, at_ends)
        tried = fit(tried_records)
    except IdentificationError:  # too little is left to say what goes on beyond
        return fit(records), ""
    clipped, counts = [], []
    for end, at_end in at_ends:
        values = tried_records[end.record].output(end.name).values
        predicted = predict(tried, tried_records[end.record], end.name)
        left = (values - predicted)[np.isfinite(values - predicted)]
        sd = 1.4826 * float(np.median(np.abs(left))) if len(left) else math.inf
        beyond = end.beyond(predicted)
        known = at_end & np.isfinite(beyond)
        if np.any(known) and np.mean(beyond[known]) > _BEYOND * sd + quantum(
            values
        ) + _MIN_BEYOND * np.nanmax(np.abs(values)):
            clipped.append((end, at_end | (beyond > -_NEAR * sd)))
            counts.append(f"{np.count_nonzero(at_end)} samples of {end.name} at {end.limit:.4g}")
    if not clipped:
        return fit(records), ""
    left_out = sum(int(np.count_nonzero(places)) for _, places in clipped)
    said = (
        f"Clipped: {', '.join(counts)} stand at the end of the sensor's range, beyond which the model goes on. They "
        f"and those that the model puts within {_NEAR:.0f} standard deviations of it are left out ({left_out})."
    )
    try:
        return fit(_left_out(records, clipped)), said
    except IdentificationError:  # a model far beyond the end everywhere is wrong itself
        return fit(records), ""


def coarse_warnings(outputs: Sequence[OutputSignal]) -> list[str]:
    """Return which outputs are rounded so coarsely that the errors follow the signal, for fits without a model.

    Parameters
    ----------
    outputs : sequence of OutputSignal

    Notes
    -----
    Without a model the noise is not known, but third differences of neighbouring samples hold at least it: ``20
    sigma^2`` of white noise.
    """
    said = []
    for output in outputs:
        values = output.values[output.is_valid]
        step = quantum(values)
        if not step or len(values) < _MIN_SAMPLES:
            continue
        most = math.sqrt(float(np.mean(np.square(np.diff(values, 3)))) / 20.0)
        if dither(np.array([most]), step) < DITHER and float(np.ptp(values)) < _COARSE * step:
            said.append(
                f"Rounding: {output.name} has steps of {step:.3g}, {np.ptp(values) / step:.0f} over its whole swing, "
                "and noise of less than half a step: its errors follow the signal as a distortion does, which no "
                "average makes smaller. Choose a finer range, or fit the samples with identify(), which weighs them."
            )
    return said


def clipped_warnings(outputs: Sequence[OutputSignal]) -> list[str]:
    """Return which outputs stand at an end of their range as if clipped, for fits that do not leave such samples out.

    Parameters
    ----------
    outputs : sequence of OutputSignal
    """
    return [
        f"Clipped: {np.count_nonzero(output.values == limit)} samples of {output.name} stand at {limit:.4g}, as at "
        "the end of the sensor's range. Set them to NaN (not seen), and take a wider range."
        for output in outputs
        for limit, _ in _limits(output.values)
    ]


def clipped_input_warnings(drives: Sequence[InputSignal]) -> list[str]:
    """Return which forces stand at an end of their range as if clipped; held ones are commands, which may stay.

    Parameters
    ----------
    drives : sequence of InputSignal
    """
    return [
        f"Clipped: {np.count_nonzero(own.values == limit)} samples of input {own.name} stand at {limit:.4g}, as at "
        "the end of the sensor's range: what acted beyond it is missing, and gains, delays and modes make up for it. "
        "Take a wider range, or leave out these blows."
        for own in drives
        if own.unit in _FORCE_UNITS and own.hold != "zoh"
        for limit, _ in _limits(own.values)
        if limit != 0.0  # between blows
    ]


def _ends(record: TimeRecord, index: int, name: str) -> list[_End]:
    """Return at which ends of its range an output may be clipped."""
    if name not in record.output_names:
        return []
    return [_End(index, name, limit, side) for limit, side in _limits(record.output(name).values)]


def _limits(values: FloatArray) -> list[tuple[float, float]]:
    """Return the limits at which samples pile up, and the side of each: 1 above, -1 below."""
    seen = values[np.isfinite(values)]
    found: list[tuple[float, float]] = []
    for side in (1.0, -1.0):
        limit = side * float(np.max(side * seen))
        at_end = seen == limit
        if np.count_nonzero(at_end) < _CLIPPED or not np.any(
            np.convolve(at_end, np.ones(_IN_A_ROW), "valid") == _IN_A_ROW
        ):
            continue
        inner = side * float(np.max(side * seen[~at_end], initial=-math.inf))
        if math.isfinite(inner) and np.count_nonzero(at_end) > _PILE * np.count_nonzero(seen == inner):
            found.append((limit, side))
    return found


def _left_out(records: list[TimeRecord], places: Sequence[tuple[_End, np.ndarray]]) -> list[TimeRecord]:
    result = list(records)
    for end, which in places:
        outputs = tuple(
            replace(output, values=np.where(which, np.nan, output.values))
            if output.name == end.name
            else output
            for output in result[end.record].outputs
        )
        result[end.record] = replace(result[end.record], outputs=outputs)
    return result
