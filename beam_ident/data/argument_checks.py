"""What every estimator asks of its arguments before it begins."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.gaps import POOR_BRIDGE, InputGap, describe_gaps
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import EstimationError

_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)  # of the largest value: less is no movement
_MIN_SIZE = 1e-100  # size of a signal: squares of what is smaller, or larger than its inverse, are lost
_MAX_RESPONSE = 1e60  # squares of squares must not overflow


def require_record(record: object) -> None:
    """Raise EstimationError for anything but one time record."""
    if not isinstance(record, TimeRecord):
        raise EstimationError(f"record is a {type(record).__name__}; expected one TimeRecord")


def require_records(
    record: object, may_lack_outputs: bool = False, takes_low_passes: bool = False
) -> list[TimeRecord]:
    """Return one time record or several of one system as a list.

    Parameters
    ----------
    record : TimeRecord or sequence of TimeRecord
    may_lack_outputs : bool -- whether a record may be without some output that others have
    takes_low_passes : bool -- whether low-passes that outputs state are taken out

    Raises
    ------
    EstimationError
        Anything else, no record at all, records whose signals differ in name or unit, or a low-pass that would not
        be taken out.
    """
    given = list(record) if isinstance(record, Sequence) and not isinstance(record, str) else [record]
    if not given:
        raise EstimationError("no record to identify from; give at least one TimeRecord")
    records = [one for one in given if isinstance(one, TimeRecord)]
    for one in given:
        if not isinstance(one, TimeRecord):
            raise EstimationError(
                f"record is a {type(one).__name__}; expected one TimeRecord, or a sequence of them"
            )
    stated = [own.name for one in records for own in one.outputs if own.low_pass is not None]
    if stated and not takes_low_passes:
        raise EstimationError(
            f"output {stated[0]!r} states a low_pass of its sensor, which is not taken out here; expected none: use "
            "identify, or leave low_pass away and take what is found as what the sensor shows"
        )
    _require_like("input", [(one.name, one.inputs) for one in records], may_lack=False)
    _require_like("output", [(one.name, one.outputs) for one in records], may_lack_outputs)
    return records


def _require_like(
    kind: str, records: Sequence[tuple[str, Sequence[InputSignal | OutputSignal]]], may_lack: bool
) -> None:
    """Raise EstimationError where signals of one kind differ between records."""
    first, signals = records[0]
    names = {signal.name for signal in signals}
    units: dict[str, tuple[str, str]] = {}
    for number, (record, signals) in enumerate(records, 1):
        own = {signal.name: signal.unit for signal in signals}
        if own.keys() != names and not may_lack:
            raise EstimationError(
                f"record 1 ({first!r}) has the {kind}s {', '.join(sorted(names))} and record {number} ({record!r}) "
                f"{', '.join(sorted(own))}; expected the same {kind}s in all records of one fit. Rename signals, "
                "or leave out what is not common"
            )
        for name, unit in own.items():
            known, where = units.setdefault(name, (unit, record))
            if unit != known:
                raise EstimationError(
                    f"{kind} {name!r} is in {known!r} in record {where!r} and in {unit!r} in record {number} "
                    f"({record!r}); expected one unit in all records of one fit. Convert one of them"
                )


def split_at_gaps(records: Sequence[TimeRecord], least: int) -> tuple[list[TimeRecord], tuple[str, ...]]:
    """Return the pieces of records between gaps of their inputs that are not bridged well, and what is to be said.

    For estimators that take several records, each with a beginning of its own.

    Parameters
    ----------
    records : sequence of TimeRecord
    least : int -- samples that every output of a piece must have; pieces with fewer are left out

    Raises
    ------
    EstimationError
        No piece has so many.
    """
    pieces: list[TimeRecord] = []
    said: list[str] = []
    for record in records:
        poor = [gap for drive in record.inputs for gap in poor_gaps(drive)]
        for drive in record.inputs:
            anew = [gap for gap in drive.gaps if gap in poor]
            said += [describe_gaps(drive.name, drive.gaps, drive.unit, anew)] if drive.gaps else []
        if not poor:
            pieces.append(record)
            continue
        starts = [-math.inf, *sorted(gap.end_s for gap in poor)]
        ends = [*sorted(gap.start_s for gap in poor), math.inf]
        for number, (start, end) in enumerate(zip(starts, ends, strict=True), 1):
            piece = _piece(record, start, end, least, f"{record.name}, piece {number}")
            pieces += [] if piece is None else [piece]
    if not pieces:
        raise EstimationError(
            f"no piece between two gaps has {least} samples of every output; expected longer pieces. {' '.join(said)}"
        )
    return pieces, tuple(said)


def poor_gaps(drive: InputSignal) -> list[InputGap]:
    """Return the gaps of an input that are not bridged well."""
    return [gap for gap in drive.gaps if not gap.sigma < POOR_BRIDGE * float(np.std(drive.values))]


def _piece(record: TimeRecord, start_s: float, end_s: float, least: int, name: str) -> TimeRecord | None:
    """Return a record between two instants where its inputs are known, None where too little is left."""
    drives, outputs = [], []
    for drive in record.inputs:
        keep = (drive.times_s >= start_s) & (drive.times_s <= end_s)
        if np.count_nonzero(keep) < 2:
            return None
        gaps = tuple(gap for gap in drive.gaps if gap.start_s >= start_s and gap.end_s <= end_s)
        drives.append(replace(drive, times_s=drive.times_s[keep], values=drive.values[keep], gaps=gaps))
    first, last = max(d.span_s[0] for d in drives), min(d.span_s[1] for d in drives)
    for output in record.outputs:
        keep = output.is_within(first, last)
        if np.count_nonzero(keep & output.is_valid) < least:
            return None
        outputs.append(replace(output, times_s=output.times_s[keep], values=output.values[keep]))
    return TimeRecord(tuple(drives), tuple(outputs), record.start_ns, name)


def require_frequency_record(record: object) -> None:
    """Raise EstimationError for anything but one frequency record."""
    if not isinstance(record, FrequencyRecord):
        raise EstimationError(
            f"record is a {type(record).__name__}; expected a FrequencyRecord (periodic_response(), "
            "welch_response() and local_polynomial_response() make one of a TimeRecord)"
        )


def require_responses(record: FrequencyRecord) -> None:
    """Raise EstimationError where a response has no finite value, is zero at every line, or of an absurd size."""
    for j, output in enumerate(record.output_names):
        for i, drive in enumerate(record.input_names):
            values = record.response[:, j, i]
            largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
            if largest > 0.0 and not 1.0 / _MAX_RESPONSE < largest < _MAX_RESPONSE:
                raise EstimationError(
                    f"frequency record {record.name!r}: the response of {output!r} to {drive!r} reaches "
                    f"{largest:.3g}; expected between {1.0 / _MAX_RESPONSE:g} and {_MAX_RESPONSE:g}. "
                    "Use other units"
                )
            if not largest > 0.0:
                what = "zero" if np.any(np.isfinite(values)) else "missing"
                raise EstimationError(
                    f"frequency record {record.name!r}: the response of {output!r} to {drive!r} is {what} at every "
                    "line; leave it out with select()"
                )


def require_input_signal(drive: object) -> None:
    """Raise EstimationError for anything but an input signal."""
    if not isinstance(drive, InputSignal):
        raise EstimationError(f"the input is a {type(drive).__name__}; expected an InputSignal")


def finite_row(what: str, values: Any) -> FloatArray:
    """Return numbers that a person gave as an array of one dimension, or raise EstimationError.

    Parameters
    ----------
    what : str -- what they are, with their unit
    values : array_like, shape (n,)
    """
    try:
        row = np.asarray(values)
        row = row if np.iscomplexobj(row) else np.asarray(row, dtype=np.float64)
    except (TypeError, ValueError) as err:
        raise EstimationError(
            f"{what} are not numbers ({err}); expected a row of finite real numbers"
        ) from err
    if np.iscomplexobj(row) or row.ndim != 1:
        kind = "complex" if np.iscomplexobj(row) else f"of shape {row.shape}"
        raise EstimationError(f"{what} are {kind}; expected a row of finite real numbers")
    if not np.all(np.isfinite(row)):
        first = int(np.flatnonzero(~np.isfinite(row))[0])
        raise EstimationError(f"{what}: number {first} is {row[first]}; expected finite real numbers")
    return row


def require_time(name: str, value: Any) -> None:
    """Raise EstimationError unless a value is a finite time of 0 or more [s]."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not is_number or not (math.isfinite(value) and value >= 0.0):
        raise EstimationError(f"{name} is {value!r}; expected a time of 0 or more [s]")


def require_arrival(drive: InputSignal, delay_s: float, output: OutputSignal) -> None:
    """Raise EstimationError for a delay so long that nothing of an input reaches an output within the record."""
    if not delay_s < float(output.times_s[-1] - drive.times_s[0]):
        raise EstimationError(
            f"the delay is {delay_s:.6g} s, but output {output.name!r} ends "
            f"{output.times_s[-1] - drive.times_s[0]:.6g} s after input {drive.name!r} begins: nothing "
            "of it has arrived. Expected a shorter delay, or a longer record"
        )


def require_whole_number(name: str, value: Any, least: int, most: int | None = None) -> None:
    """Raise EstimationError unless a value is a whole number between two limits, both included."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool | np.bool_)
    if not is_whole or value < least or (most is not None and value > most):
        bounds = f"at least {least}" if most is None else f"{least} to {most}"
        raise EstimationError(f"{name} is {value!r}; expected a whole number, {bounds}")


def require_size(what: str, values: FloatArray) -> None:
    """Raise EstimationError for values that are not zero and whose squares leave the range of numbers."""
    size = float(np.max(np.abs(values), initial=0.0))
    if size > 0.0 and not _MIN_SIZE < size < 1.0 / _MIN_SIZE:
        raise EstimationError(
            f"{what} reaches {size:.3g}, whose square is beyond what can be computed with; expected "
            f"{_MIN_SIZE:g} to {1.0 / _MIN_SIZE:g}. Check its unit, or its sensor"
        )


def require_output(name: str, values: FloatArray) -> None:
    """Raise EstimationError for an output that never changes, or of an absurd size.

    Parameters
    ----------
    name : str
    values : ndarray, shape (n,) -- the samples that can be used; whether they are enough is asked elsewhere
    """
    require_size(f"output {name!r}", values)
    size = float(np.max(np.abs(values), initial=0.0))
    if len(values) > 1 and np.ptp(values) <= _ROUNDING * size:
        raise EstimationError(
            f"output {name!r} is constant ({values[0] + 0.0:g}) over {len(values)} samples; nothing can be "
            "identified from it. Check the sensor, or leave this output out"
        )


def chosen_input(record: TimeRecord, input_name: str | None) -> InputSignal:
    """Return the input of a name, or the only one; raise EstimationError where there are several, or for its size."""
    if input_name is None and len(record.inputs) > 1:
        raise EstimationError(
            f"record {record.name!r} has the inputs {', '.join(s.name for s in record.inputs)}; say which with "
            "input_name"
        )
    drive = record.inputs[0] if input_name is None else record.input(input_name)
    require_input(drive, is_needed=False)
    return drive


def chosen_inputs(record: TimeRecord, names: str | Sequence[str] | None) -> tuple[InputSignal, ...]:
    """Return the inputs of some names, or all; raise EstimationError where there is none of a name, or none named."""
    if names is None:
        return record.inputs
    asked = [names] if isinstance(names, str) else list(names)
    if not asked or len(set(asked)) < len(asked):
        raise EstimationError(
            f"input_name is {names!r}; expected different names among {', '.join(s.name for s in record.inputs)}, "
            "or None for all of them"
        )
    return tuple(record.input(name) for name in asked)


def require_input(drive: InputSignal, is_needed: bool = True) -> None:
    """Raise EstimationError for an input of an absurd size, or one at zero throughout where it is needed."""
    require_size(f"input {drive.name!r}", drive.values)
    if is_needed and not np.any(drive.values):
        raise EstimationError(f"input {drive.name!r} is zero throughout; it excites nothing")


def require_signals(records: Sequence[TimeRecord]) -> None:
    """Raise EstimationError for an input or output of absurd size, or an output that never changes in a record."""
    for record in records:
        for drive in record.inputs:
            require_input(drive, is_needed=False)
        for output in record.outputs:
            require_output(output.name, output.values[output.is_valid])


def require_excitation(records: Sequence[TimeRecord], name: str) -> None:
    """Raise EstimationError for an input that is at zero throughout all records."""
    if not any(np.any(record.input(name).values) for record in records):
        raise EstimationError(f"input {name!r} is zero throughout; it excites nothing")


def require_moving_input(drive: InputSignal) -> None:
    """Raise EstimationError for an input that is constant, of an absurd size, or not known for a while."""
    require_size(f"input {drive.name!r}", drive.values)
    if poor := poor_gaps(drive):
        raise EstimationError(
            f"a frequency response needs an input without gaps. {describe_gaps(drive.name, poor, drive.unit)} That "
            "is not sure enough: take a stretch between them (record.between), or identify(), which takes all of them"
        )
    if np.ptp(drive.values) == 0.0:
        raise EstimationError(
            f"input {drive.name!r} is constant ({drive.values[0] + 0.0:g}); it excites no frequency"
        )
