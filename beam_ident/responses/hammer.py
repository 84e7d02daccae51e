"""Frequency responses from blows of a hammer: found, windowed, averaged.

A blow is short and its response rings on, so that each is seen through a window of its own.  The force is
cut off where the contact ends, because it is zero there and its sensor's noise is not.  Force and response are
multiplied by the same exponential, which leaves no leakage at the end of a segment and turns ``H(j omega)`` into
``H(j omega + decay_rate)`` exactly: the record carries the rate, and fits take the damping back out.  Over the
blows H1 is averaged; what every blow leaves beside it is the noise of each line.

The samples themselves know more than windowed lines: ``identify`` fits them without any window.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import (
    chosen_input,
    require_moving_input,
    require_output,
    require_records,
)
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.numerics.convolution import running_mean
from beam_ident.numerics.piecewise import regular_period
from beam_ident.responses.doubts import with_doubts
from beam_ident.responses.steady_periods import changing_warnings
from beam_ident.sensing.blows import Blow, find_blows
from beam_ident.sensing.clock_rate import Stretches, clock_warnings
from beam_ident.sensing.noise_floor import noise_floor

_FLOOR_SHARE = 0.25  # of the samples: degrees of freedom of noise that is known from its quietest lines
_FREEDOM = 40.0  # degrees of freedom to which the noise of neighbouring lines is averaged
_MIN_FORCE = 1e-3  # of the largest power of the force: below, a line shows noise
_PER_CYCLE = 2.56  # samples of an output in a cycle of the highest line, as analysers have it
_END_SHARE = 1e-3
_HIDDEN = 0.3  # of what noise shows: leakage that does not matter
_WINDOWS = 4  # tried, from wide to narrow
_MIN_SAMPLES = 32  # of a segment


def hammer_response(
    records: TimeRecord | Sequence[TimeRecord],
    segment_s: float | None = None,
    end_share: float | None = None,
    output_names: Sequence[str] | None = None,
    input_name: str | None = None,
) -> FrequencyRecord:
    """Estimate a frequency response from the blows of a hammer (H1 over all of them).

    Parameters
    ----------
    records : TimeRecord or a sequence of them
        Each with one blow or several; outputs at regular stamps, one period for all.
    segment_s : float or None
        How long each blow is looked at [s]; None takes the shortest time to the next blow, or to the end.
    end_share : float or None
        What the exponential window is at the end of a segment; 1 for no window. None takes a thousandth, or so little
        that what rings on at the end shows less than the noise.
    output_names : sequence of str or None -- None takes all
    input_name : str or None -- which input, where there are several

    Raises
    ------
    EstimationError
        No blow, irregular or missing samples, segments too short, a share outside 0 to 1.

    Notes
    -----
    Blows of more than one contact are named in the record's ``warnings`` and left out, as long as there are others.
    Lines with less than a thousandth of the force's largest power, and those above 1/2.56 of the sampling rate, where
    filters let frequencies fold, are left out. Where the force is sampled more often than the outputs, variances
    count what of it folds. With one blow they are those of white noise, at the level of the quietest quarter of the
    outputs' lines.
    """
    data = require_records(records)
    if end_share is not None and not 0.0 < end_share <= 1.0:
        raise EstimationError(f"end_share is {end_share}; expected above 0 and at most 1 (no window)")
    drives = [_drive(record, input_name) for record in data]
    names = list(data[0].output_names if output_names is None else output_names)
    outputs = [[record.output(name) for name in names] for record in data]
    period = _common_period([own for group in outputs for own in group])
    blows = [(k, blow) for k, drive in enumerate(drives) for blow in find_blows(drive)]
    if not blows:
        raise EstimationError("no blow stands out of the force's noise; check the sensor, or strike harder")
    segment = _segment(blows, outputs, segment_s)
    length = int(segment / period + 1e-6)
    if length < _MIN_SAMPLES:
        raise EstimationError(
            f"segments of {segment:.4g} s hold {length} samples; expected at least {_MIN_SAMPLES}. Leave more time "
            "between blows, or give segment_s"
        )
    chosen, said = _clean(blows, segment, outputs)
    segments = [_Segment(drives[k], tuple(outputs[k]), blow, length, period) for k, blow in chosen]
    rings_on = max(own.ringing_on for own in segments)
    share = _END_SHARE if end_share is None else end_share
    for _ in range(_WINDOWS):
        found = _averaged(segments, share)
        # A phase that leakage turns, in a fit of many lines, against what their noise lets know of it.
        information = np.sum(np.abs(found.response) ** 2 / found.variance, axis=1)
        limit = 1.0 / math.sqrt(float(np.max(information)))
        if end_share is not None or rings_on * share < _HIDDEN * limit:
            break
        share = 0.5 * _HIDDEN * limit / rings_on
    if rings_on * share > limit:
        said = (
            *said,
            f"{rings_on * share:.2g} of the first ringing is left at the end of the segments and leaks, where noise "
            f"shows {limit:.1g}: give a smaller end_share, or fit the samples with identify()",
        )
    first, n = outputs[0], len(segments)
    turned = -math.log(share)
    # The noise is loudest where the window begins: by so much more than on average a mode may gain there by chance.
    loudest = 2.0 * turned / (1.0 - share**2) if share < 1.0 else 1.0
    made = FrequencyRecord(
        found.lines,
        found.response.T,
        found.variance.T,
        tuple(names),
        (drives[0].name,),
        tuple(own.unit for own in first),
        (drives[0].unit,),
        None if found.coherence is None else found.coherence.T,
        degrees_of_freedom=found.freedom,
        method=f"H1 over {n} blow{'s' if n > 1 else ''}",
        name=data[0].name,
        shared_lines=loudest,
        warnings=said,
        decay_rate=turned / (length * period),
    )
    for group, drive in zip(outputs, drives, strict=True):
        made = with_doubts(made, group, drive)
    starts = np.array([blow.start_s for _, blow in chosen])
    changes: list[str] = []
    for j, name in enumerate(names):
        # A damaged channel changes too, and is named as what it is.
        changes += changing_warnings(name, *found.compared(j)) if made.warnings == said else []
        changes += clock_warnings(name, [Stretches(found.force, found.answers[:, j], found.lines, starts)])
    return replace(made, warnings=(*made.warnings, *changes))


@dataclass(frozen=True, eq=False)
class _Averaged:
    """H1 at lines, shape (n_outputs, n_lines), and what the blows leave beside it."""

    lines: FloatArray
    response: ComplexArray
    variance: FloatArray
    coherence: FloatArray | None
    freedom: float
    force: ComplexArray  # of every blow
    answers: ComplexArray  # of every blow and output
    shared_lines: float

    def compared(self, output: int) -> tuple[ComplexArray, ComplexArray, FloatArray, float]:
        """Return what the response makes of every blow, what was measured, where, and what lines share."""
        return self.response[output] * self.force, self.answers[:, output], self.lines, self.shared_lines


@dataclass(frozen=True, eq=False)
class _Segment:
    """One blow, and ``length`` samples of every output after it."""

    drive: InputSignal
    outputs: tuple[OutputSignal, ...]
    blow: Blow
    length: int
    period: float

    @property
    def ringing_on(self) -> float:
        """How much of the first tenth the last tenth still is, for the output that rings longest."""
        tenth, most = max(self.length // 10, 1), 0.0
        for output in self.outputs:
            values = self._values(output)[1]
            begin, end = (float(np.std(part)) for part in (values[:tenth], values[-tenth:]))
            most = max(most, end / max(begin, 1e-300))
        return most

    def _values(self, output: OutputSignal) -> tuple[float, FloatArray]:
        """Return when after the start the first sample is [s], and the samples without what was there before."""
        first = int(np.searchsorted(output.times_s, self.blow.start_s - 1e-9))
        rest = float(np.mean(output.values[:first])) if first >= _MIN_SAMPLES else 0.0
        values = output.values[first : first + self.length] - rest
        return float(output.times_s[first]) - self.blow.start_s, values

    def noise_floors(self, rate: float) -> FloatArray:
        """Return the deviation of the outputs' transforms that white noise beneath their motion makes, one each."""
        window = np.exp(-rate * self.period * np.arange(self.length))
        times = np.asarray(self.period * np.arange(self.length), dtype=np.float64)
        floors = [noise_floor(times, self._values(output)[1]) for output in self.outputs]
        return np.asarray(floors) * float(np.linalg.norm(window)) * self.period

    def force(self, s: ComplexArray) -> ComplexArray:
        """Return the Laplace transform of the force from its start, without what is not a contact."""
        drive, blow = self.drive, self.blow
        width = blow.end_s - blow.start_s
        keep = (drive.times_s >= blow.start_s) & (drive.times_s <= blow.end_s + 0.5 * width)
        times = drive.times_s[keep] - blow.start_s
        # Between samples a straight line, as good as a spline where a contact has several samples.
        values = (drive.values[keep] - float(np.median(drive.values))) * np.gradient(times)
        return np.asarray(np.exp(-s[:, None] * times) @ values)

    def folded_power(self, rate: float, lines: FloatArray) -> FloatArray:
        """Return the force's power at the frequencies that the outputs' sampling folds onto these lines.

        Zero where the force is not sampled so often that it shows it.
        """
        if 1.5 * float(np.median(np.diff(self.drive.times_s))) > self.period:
            return np.zeros(len(lines))
        images = 2.0 * np.pi / self.period - lines
        return np.asarray(np.abs(self.force(np.asarray(rate + 1j * images, dtype=np.complex128))) ** 2)

    def answers(self, rate: float, lines: FloatArray) -> ComplexArray:
        """Return the transforms of the outputs under the exponential window, shape (n_outputs, n_lines)."""
        found = []
        for output in self.outputs:
            late, values = self._values(output)
            seen = values * np.exp(-rate * (late + self.period * np.arange(self.length))) * self.period
            # The first stamp lies a part of a period after the start.
            found.append(np.fft.fft(seen)[1 : len(lines) + 1] * np.exp(-1j * lines * late))
        return np.stack(found)


def _reach(share: float) -> float:
    """Return how many lines have one degree of freedom in common under a window that ends at this share.

    Notes
    -----
    The sum of the squared correlations of a line with all others; they are the transform of the window's square.
    """
    turned = -math.log(share)
    return turned / math.tanh(turned) if turned > 0.0 else 1.0


def _averaged(segments: Sequence[_Segment], share: float) -> _Averaged:
    """Return H1 over all blows under a window that ends at this share."""
    length, period = segments[0].length, segments[0].period
    rate = -math.log(share) / (length * period)
    lines = np.asarray(2.0 * np.pi * np.arange(1, (length + 1) // 2) / (length * period), dtype=np.float64)
    force = np.stack([own.force(np.asarray(rate + 1j * lines, dtype=np.complex128)) for own in segments])
    answers = np.stack([own.answers(rate, lines) for own in segments])
    power = np.sum(np.abs(force) ** 2, axis=0)
    low = np.flatnonzero((power < _MIN_FORCE * np.max(power)) | (lines > 2.0 * np.pi / (_PER_CYCLE * period)))
    keep = slice(0, max(int(low[0]) if len(low) else len(lines), 2))
    lines, force, answers, power = lines[keep], force[:, keep], answers[:, :, keep], power[keep]
    cross = np.einsum("bol,bl->ol", answers, np.conj(force))
    response = cross / power
    n, reach, coherence = len(segments), _reach(share), None
    if n > 1:
        left = np.sum(np.abs(answers - response * force[:, None]) ** 2, axis=0) / (n - 1.0)
        width = min(math.ceil(_FREEDOM * reach / (n - 1.0)), len(lines))
        variance = running_mean(left, width) / power
        coherence = np.clip(np.abs(cross) ** 2 / (np.sum(np.abs(answers) ** 2, axis=0) * power), 0.0, 1.0)
        freedom = max((n - 1.0) * width / reach, 1.0)
    else:
        # Of one blow nothing is left over: its noise is what no motion covers, white, as the force shows it.
        variance = np.square(segments[0].noise_floors(rate))[:, None] / power
        freedom = max(_FLOOR_SHARE * length, 1.0)
    # What folds has passed through the response above the band, which is about what it is at its upper end. It is the
    # same in every blow, so that no scatter shows it.
    above = np.median(np.abs(response[:, -max(len(lines) // 10, 1) :]) ** 2, axis=1)
    variance += above[:, None] * np.sum([own.folded_power(rate, lines) for own in segments], axis=0) / power
    return _Averaged(lines, response, variance, coherence, freedom, force, answers, reach)


def _drive(record: TimeRecord, input_name: str | None) -> InputSignal:
    drive = chosen_input(record, input_name)
    require_moving_input(drive)
    return drive


def _common_period(outputs: Sequence[OutputSignal]) -> float:
    """Return the period of all outputs [s], or raise EstimationError."""
    periods = []
    for output in outputs:
        own = regular_period(output.times_s)
        if own is None or not np.all(output.is_valid):
            raise EstimationError(
                f"output {output.name!r} has {'irregular stamps' if own is None else 'missing samples'}; segments of "
                "blows need regular ones. identify() takes any stamps"
            )
        require_output(output.name, output.values)
        periods.append(own)
    if np.ptp(periods) > 1e-6 * min(periods):
        raise EstimationError(
            f"the outputs have periods of {min(periods):.6g} to {max(periods):.6g} s; expected one for all"
        )
    return float(np.mean(periods))


def _segment(
    blows: Sequence[tuple[int, Blow]], outputs: Sequence[Sequence[OutputSignal]], wanted_s: float | None
) -> float:
    """Return how long all blows can be looked at [s]."""
    longest = math.inf
    for place, (k, blow) in enumerate(blows):
        end = min(float(own.times_s[-1]) for own in outputs[k])
        if place + 1 < len(blows) and blows[place + 1][0] == k:
            end = min(end, blows[place + 1][1].start_s)
        longest = min(longest, end - blow.start_s)
    if wanted_s is None:
        return longest
    if not 0.0 < wanted_s <= longest:
        raise EstimationError(
            f"segment_s is {wanted_s}; expected above 0 and at most {longest:.4g} s, the shortest time after a blow"
        )
    return wanted_s


def _clean(
    blows: Sequence[tuple[int, Blow]], segment_s: float, outputs: Sequence[Sequence[OutputSignal]]
) -> tuple[list[tuple[int, Blow]], tuple[str, ...]]:
    """Return the blows to average, and what is to be said of the others."""
    seen = [(k, b) for k, b in blows if b.start_s >= max(float(own.times_s[0]) for own in outputs[k]) - 1e-9]
    single = [(k, blow) for k, blow in seen if blow.n_contacts == 1]
    verdict = "was left out" if single else "is averaged all the same, for want of others"
    said = [
        f"the blow at {blow.start_s:.4g} s came in {blow.n_contacts} contacts within "
        f"{blow.end_s - blow.start_s:.3g} s, and {verdict}"
        for _, blow in seen
        if blow.n_contacts > 1
    ]
    if not seen:
        raise EstimationError(
            f"no blow has {segment_s:.3g} s of all outputs after it; begin the record before the blow"
        )
    return single or seen, tuple(said)
