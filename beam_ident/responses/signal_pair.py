"""Input and output at common regular stamps, from which a frequency response is estimated.

The input is taken at the stamps of the output, through its hold and with the same
exposure, so that both have the same sampling; the outputs are never interpolated
except over single missing samples.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import (
    chosen_input,
    require_moving_input,
    require_output,
    require_record,
)
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.noise.outliers import outliers, spoiling
from beam_ident.numerics.piecewise import Instants, regular_period
from beam_ident.responses.doubts import with_doubts
from beam_ident.responses.half_power import half_power_damping
from beam_ident.responses.periods import hold_gain
from beam_ident.responses.steady_periods import changing_warnings
from beam_ident.sensing.clock_rate import clock_of_samples

_MAX_MISSING = 0.02
_SEEN = 3.0  # standard deviations
_LINES = 0.1  # of all: what noise alone never reaches


@dataclass(frozen=True, eq=False)
class SignalPair:
    """Input, output and perhaps a reference at common regular stamps."""

    period: float
    drive: FloatArray
    output: FloatArray
    reference: FloatArray | None


@dataclass(frozen=True, eq=False)
class LineEstimate:
    """A response of one output: lines [rad/s], complex values, variances, coherence.

    ``compared`` holds what ``changing_warnings`` takes beside the name: spectra of stretches, modelled and measured.
    ``left`` is what the response to the input leaves of the output in time.
    ``doubts`` is what the estimator itself has to say of the lines. ``resolution_hz`` is how far lines are smoothed
    together; a resonance that is no wider looks lower and broader than it is.
    """

    omegas: FloatArray
    response: ComplexArray
    variance: FloatArray
    coherence: FloatArray | None
    freedom: float
    compared: tuple[ComplexArray, ComplexArray, FloatArray, float, bool] | None = None
    shared_lines: float = 1.0
    left: FloatArray | None = None
    doubts: tuple[str, ...] = ()
    resolution_hz: float | None = None


def signal_pair(drive: InputSignal, output: OutputSignal, reference: InputSignal | None) -> SignalPair:
    """Bring an input, an output and perhaps a reference to the output's own regular stamps."""
    first, last = drive.span_s
    if reference is not None:
        first, last = max(first, reference.span_s[0]), min(last, reference.span_s[1])
    keep = output.is_within(first, last)
    times, values = np.asarray(output.times_s[keep]), np.array(output.values[keep])
    period = regular_period(times)
    if period is None or len(times) < 32:
        raise EstimationError(
            f"output {output.name!r} has {len(times)} usable stamps, "
            f"{'irregular ones' if period is None else 'too few'}; a non-parametric response needs at least 32 on "
            "a regular grid. Fit a model instead: identify() takes any stamps"
        )
    missing = ~np.isfinite(values)
    if np.mean(missing) > _MAX_MISSING:
        raise EstimationError(
            f"output {output.name!r}: {np.mean(missing):.1%} of the samples are missing; a non-parametric response "
            f"bridges at most {_MAX_MISSING:.0%}. Fit a model instead: identify() leaves them out"
        )
    values[missing] = np.interp(times[missing], times[~missing], values[~missing])
    require_output(output.name, values)

    def seen(source: InputSignal) -> FloatArray:
        signal = source.signal()
        return Instants.on(signal, times, output.exposure_s).mean(signal)[0]

    return SignalPair(period, seen(drive), values, None if reference is None else seen(reference))


def for_every_output(
    record: TimeRecord,
    output_names: Sequence[str] | None,
    input_name: str | None,
    reference_name: str | None,
    method: str,
    estimate: Callable[[SignalPair], LineEstimate],
) -> FrequencyRecord:
    """Estimate the response of every output asked for, and put them into one frequency record."""
    require_record(record)
    drive = chosen_input(record, input_name)
    require_moving_input(drive)
    reference = None if reference_name is None else record.input(reference_name)
    outputs = [record.output(n) for n in (record.output_names if output_names is None else output_names)]
    pairs = [signal_pair(drive, output, reference) for output in outputs]
    found = [estimate(pair) for pair in pairs]
    for output, one in zip(outputs, found, strict=True):
        if not np.array_equal(one.omegas, found[0].omegas):
            raise EstimationError(
                f"outputs {outputs[0].name!r} and {output.name!r} have different stamps, and so different lines; "
                "estimate them one at a time, with output_names"
            )
    changes = [
        said
        for output, one in zip(outputs, found, strict=True)
        if one.compared is not None
        for said in changing_warnings(output.name, *one.compared)
    ]
    for output, pair in zip(outputs, pairs, strict=True):
        changes += clock_of_samples(output.name, pair.drive, pair.output, pair.period)
    coherences = [one.coherence for one in found if one.coherence is not None]
    made = FrequencyRecord(
        omegas=found[0].omegas,
        response=np.stack([one.response for one in found], axis=1),
        variance=np.stack([one.variance for one in found], axis=1),
        output_names=tuple(output.name for output in outputs),
        input_names=(drive.name,),
        output_units=tuple(output.unit for output in outputs),
        input_units=(drive.unit,),
        coherence=np.stack(coherences, axis=1) if coherences else None,
        degrees_of_freedom=min(one.freedom for one in found),
        method=method,
        name=record.name,
        shared_lines=max(one.shared_lines for one in found),
    )
    doubts = dict.fromkeys(said for one in found for said in one.doubts)
    narrow = [
        said
        for j, one in enumerate(found)
        if one.resolution_hz is not None
        for said in _narrow(made, j, one.resolution_hz)
    ]
    made = replace(made, warnings=(*doubts, *narrow, *_hold_warning(made, drive, outputs)))
    spiky = [said for output, one in zip(outputs, found, strict=True) for said in _outliers(output.name, one)]
    return with_doubts(made, outputs, drive, [*spiky, *changes])


def _narrow(made: FrequencyRecord, output: int, resolution_hz: float) -> tuple[str, ...]:
    """Return that an output's highest peak is no wider than what the lines are smoothed over.

    Notes
    -----
    Of single modes under noise, smoothed over as much as their half-power band, the damping that is read is 7 %
    (local polynomials) to 13 % (Hann windows) too high, over twice as much 31 to 44 %, over half as much 1 to 3 %.
    """
    assert made.variance is not None
    values, variance = made.response[:, output, 0], made.variance[:, output, 0]
    seen = np.isfinite(values) & (np.abs(values) > _SEEN * np.sqrt(np.nan_to_num(variance)))
    if np.count_nonzero(seen) < 3:
        return ()
    try:
        peak = half_power_damping(FrequencyRecord(made.omegas[seen], values[seen]))
    except EstimationError:
        return ()
    width_hz = (peak.high - peak.low) / (2.0 * np.pi)
    if width_hz > resolution_hz:
        return ()
    return (
        f"output {made.output_names[output]!r}: the peak at {peak.natural_frequency / (2.0 * np.pi):.4g} Hz is "
        f"{width_hz:.3g} Hz wide at half power, and the record is too short for it: lines are smoothed over "
        f"{resolution_hz:.3g} Hz, so that it looks lower and more damped than it is. Record longer, take longer "
        "segments or whole periods, periodic_response(), or fit the samples, identify()",
    )


def _hold_warning(
    made: FrequencyRecord, drive: InputSignal, outputs: Sequence[OutputSignal]
) -> tuple[str, ...]:
    """Return what a held input does to responses that take it where it was sampled, if it shows.

    Notes
    -----
    A zero-order hold delays the input by half a sample, ``gain - 1`` of (F.3).  Under an exposure the input is
    averaged as it is held.
    """
    step = drive.period_s
    if drive.hold != "zoh" or step is None or made.variance is None or any(o.exposure_s for o in outputs):
        return ()
    wrong = np.abs(hold_gain("zoh", made.omegas, step) - 1.0)[:, None, None] * np.abs(made.response)
    wrong, known = wrong[measured := np.isfinite(wrong)], made.variance[measured]
    share = float(np.mean(wrong > _SEEN * np.sqrt(known)))
    if share < _LINES:
        return ()
    return (
        f"the input {drive.name!r} is held between its samples, which delays it by {0.5e3 * step:.3g} ms: at "
        f"{share:.0%} of the lines the response lags by more than {_SEEN:g} standard deviations, and modes fitted to "
        "it are biased. Fit the samples, identify(), or take whole periods, periodic_response(): both know the hold",
    )


def _outliers(name: str, found: LineEstimate) -> list[str]:
    """Return that single samples of an output stand off what the response makes of the input."""
    if found.left is None:
        return []
    places = outliers(found.left)
    if not spoiling(found.left, places):
        return []
    return [
        f"Outliers: {len(places)} of {len(found.left)} samples of {name} stand alone among their neighbours, far off "
        "what the response makes of the input, and are in every line. Set them to NaN (not seen), and estimate again."
    ]
