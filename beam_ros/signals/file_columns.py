"""The columns of a file as signals of identification: what is a field of a topic in a bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from beam_ident.data.stamp_order import StampOrder
from beam_ros.bags.signals import Unreadable
from beam_ros.errors import UsageError
from beam_ros.files.columns import (
    ColumnFile,
    choose_column,
    find_column,
    named_apart,
    read_columns,
    time_base,
)
from beam_ros.files.formats import open_columns
from beam_ros.files.units import INPUT_KINDS, OUTPUT_KINDS, find_unit
from beam_ros.signals.descriptions import Signals, SignalSource
from beam_ros.signals.fields import FieldSamples

NO_INPUT = "none"
"""Named as the input, it says that nothing drives the outputs."""

Sampled = tuple[SignalSource, FieldSamples]


def read_file_signals(
    path: Path,
    signals: Signals,
    time: str,
    notes: list[str],
    *,
    start_s: float | None = None,
    end_s: float | None = None,
) -> list[Sampled]:
    """Return the input of a file of columns, and its outputs, each with what it was taken for.

    Parameters
    ----------
    path : Path
    signals : Signals -- an input and at least one output
    time : str -- as of ``time_base``
    notes : list of str -- gets what a reader must know
    start_s, end_s : float, optional -- only what lies between these times after the first row [s]

    Raises
    ------
    ColumnFileError
        The file cannot be read, lacks a column or a unit, or has times that cannot be right.
    UsageError
        Input or outputs are not named, or a column measures something else.
    """
    if signals.drive is None or not signals.outputs:
        which = "the input" if signals.drive is None else "an output"
        raise UsageError(
            f"{path}: {which} is not named; name both with --input and --output, among its columns: "
            f"{_headings(path)}. Where outputs ring freely, `beam identify --input {NO_INPUT}` needs no input"
        )
    if signals.drive.field == NO_INPUT:
        raise UsageError(
            f"{path}: --input {NO_INPUT}, for outputs that ring freely; expected an input here: only "
            "`beam identify`, of one file, does without"
        )
    return _sampled(
        path, [(signals.drive, True), *((own, False) for own in signals.outputs)], time, notes, start_s, end_s
    )


def read_file_outputs(
    path: Path,
    signals: Signals,
    time: str,
    notes: list[str],
    *,
    start_s: float | None = None,
    end_s: float | None = None,
) -> list[Sampled]:
    """Return the outputs of a file of columns that nothing drives; as ``read_file_signals`` but for the input."""
    if not signals.outputs:
        raise UsageError(
            f"{path}: no output is named; name those that ring with --output, among its columns: {_headings(path)}"
        )
    return _sampled(path, [(own, False) for own in signals.outputs], time, notes, start_s, end_s)


def _headings(path: Path) -> str:
    return ", ".join(own.heading for own in open_columns(path).columns)


def _sampled(
    path: Path,
    told: Sequence[tuple[SignalSource, bool]],
    time: str,
    notes: list[str],
    start_s: float | None,
    end_s: float | None,
) -> list[Sampled]:
    """Return the samples of signals, each given with whether it is an input."""
    file = open_columns(path)
    base = time_base(file, time)
    sources = [_known_source(file, own, is_input) for own, is_input in told]
    choices = [choose_column(file, own.field, own.unit) for own in sources]
    # A value of an output may be missing, as of a marker that was not seen.
    data = read_columns(
        file,
        base,
        [replace(own, unit=replace(own.unit, factor=1.0)) for own in choices],
        [is_input for _, is_input in told],
        start_s=start_s,
        end_s=end_s,
    )
    notes += data.notes
    stamps = np.rint(data.times_s * 1e9).astype(np.int64)
    order = StampOrder(np.arange(len(stamps)), 0, 0, ())
    return [
        (own, FieldSamples(path.name, own.field, stamps, values, True, 0, Unreadable(0, ""), order))
        for own, values in zip(sources, data.values, strict=True)
    ]


def _known_source(file: ColumnFile, source: SignalSource, is_input: bool) -> SignalSource:
    """Return a signal with its column's heading, name and unit; refuse a unit in which no such signal is."""
    if source.topic:
        source = replace(source, topic="", field=f"{source.topic}:{source.field}")
    column = find_column(file, source.field)
    choice = choose_column(file, column.heading, source.unit)
    names = {own.heading: own.name for own in named_apart(file.columns)}
    kinds = INPUT_KINDS if is_input else OUTPUT_KINDS
    if choice.unit.si not in kinds and not source.kind:
        known = sorted({unit for unit in kinds if find_unit(unit)})
        raise UsageError(
            f"{file.path}: column {column.heading!r} is in {source.unit or column.unit}, not a unit of an "
            f"{'input' if is_input else 'output'}; expected one of {', '.join(known)} and their multiples, or the "
            "kind of sensor and its scale behind the name, as accel_V,kind=accelerance,scale=98.1"
        )
    return replace(
        source,
        field=column.heading,
        unit=source.unit or column.unit,
        name=source.name or names[column.heading],
    )
