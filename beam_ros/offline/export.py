"""A bag in forms that other tools read: flat CSV files, and a flat bag with one sample a message.

Plotting tools unpack a JointState by its names, but not the batches of the hub; spreadsheets read CSV. Nothing
is resampled or filled here: every signal keeps its own clock and its gaps.
"""

from __future__ import annotations

import csv
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beam_ros import messages
from beam_ros.arrays import FloatArray, StampArray
from beam_ros.bags.errors import BagError, BagExistsError, MissingTopicsError
from beam_ros.bags.reading import Bag
from beam_ros.bags.stamped_rows import StampedRows
from beam_ros.bags.writing import BagWriter
from beam_ros.interfaces import graph
from beam_ros.messages import BATCH_FIELDS, SECOND_NS, BagTypes

QUANTITY_COLUMNS = {
    "positions": "position_m",
    "velocities": "velocity_m_s",
    "accelerations": "acceleration_m_s2",
    "efforts": "effort_N",
}
"""Names of the hub's quantities, with their units, in CSV files and flat bags."""

_SIGNAL_TOPICS = ("hub/applied", "hub/measured", "beam/displacement")
_COPIED_TOPICS = ("excitation/info", "hub/sequence_state", "hub/clock_sync", "/diagnostics")
_ROWS_AT_ONCE = 10_000

Progress = Callable[[float], None]
"""Called with the share that is done, from 0 to 1."""


@dataclass(frozen=True)
class _Signal:
    """A sampled signal: topic, column names, stamps [ns] of shape (n,), values of shape (n, columns)."""

    topic: str
    columns: tuple[str, ...]
    stamps_ns: StampArray
    values: FloatArray


def _signals(bag: Bag) -> list[_Signal]:
    """Return what the bag has of the hub's batches and the displacements.

    Raises
    ------
    MissingTopicsError
        It has none of them.
    """
    signals = []
    for topic in _SIGNAL_TOPICS:
        if not bag.count(topic):
            continue
        if topic == "beam/displacement":
            table = bag.displacements()
            columns = tuple(f"{name}_m" for name in table.names)
            signals.append(_Signal(topic, columns, table.stamps_ns, table.positions))
            continue
        samples = bag.hub_samples(topic)
        present = [name for name in BATCH_FIELDS if getattr(samples, name) is not None]
        values = np.column_stack([getattr(samples, name) for name in present])
        columns = tuple(QUANTITY_COLUMNS[name] for name in present)
        signals.append(_Signal(topic, columns, samples.stamps_ns, values))
    if not signals:
        there = ", ".join(row.name for row in bag.topics) or "no topics"
        raise MissingTopicsError(
            f"{bag.path} has no signal to export: it holds {there}, expected at least one of "
            f"{', '.join(_SIGNAL_TOPICS)}; choose another bag"
        )
    return signals


def export_csv(bag: Bag, folder: Path | str, progress: Progress = lambda share: None) -> tuple[Path, ...]:
    """Write one CSV file for each signal into a new folder.

    Parameters
    ----------
    bag : Bag -- open
    folder : Path or str -- must not exist; appears whole or not at all
    progress : callable, optional

    Returns
    -------
    tuple of Path -- the files. Their columns: ``stamp_ns`` (UNIX), ``time_s`` since the earliest stamp of all
        signals, and the signal's own, in SI units; ``nan`` where a marker was not seen

    Raises
    ------
    BagExistsError
        Something is at ``folder``.
    MissingTopicsError
        The bag has no signal.
    BagError
        The disk refuses.
    """
    folder = Path(folder)
    if folder.exists():
        raise BagExistsError(f"{folder} exists already: expected a new folder; give another one")
    signals = _signals(bag)
    start_ns = min(int(signal.stamps_ns[0]) for signal in signals)
    total = sum(len(signal.stamps_ns) for signal in signals)
    done = 0
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            for signal in signals:
                with (draft / _csv_name(signal)).open("w", newline="", encoding="utf-8") as file:
                    writer = csv.writer(file)
                    writer.writerow(("stamp_ns", "time_s", *signal.columns))
                    for first in range(0, len(signal.stamps_ns), _ROWS_AT_ONCE):
                        part = slice(first, first + _ROWS_AT_ONCE)
                        stamps = signal.stamps_ns[part]
                        times = (stamps - start_ns) / SECOND_NS
                        columns = (stamps, times, *signal.values[part].T)
                        writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
                        progress((done + min(part.stop, len(signal.stamps_ns))) / total)
                done += len(signal.stamps_ns)
            draft.chmod(0o755)
            draft.replace(folder)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise
    except OSError as err:
        raise BagError(
            f"cannot write {folder}: {err.strerror or err}; check the path, its permissions and the space"
        ) from err
    return tuple(folder / _csv_name(signal) for signal in signals)


def _csv_name(signal: _Signal) -> str:
    return f"{signal.topic.replace('/', '_')}.csv"


def export_flat_bag(bag: Bag, target: Path | str, progress: Progress = lambda share: None) -> int:
    """Write a bag with one sample a message, for plotting tools.

    Parameters
    ----------
    bag : Bag -- open
    target : Path or str -- the new bag's folder
    progress : callable, optional

    Returns
    -------
    int -- number of messages written. ``hub/applied`` and ``hub/measured`` become a JointState for each sample,
        whose names are the quantities with their units and whose positions are the values; displacements stay
        a JointState for each frame. Receive times are the stamps, so that tools which plot against either
        agree. Texts, clock comparisons and diagnostics are copied.

    Raises
    ------
    BagExistsError
        Something is at the target.
    MissingTopicsError
        The bag has no signal.
    """
    signals = _signals(bag)
    total = sum(len(signal.stamps_ns) for signal in signals)
    with BagWriter(target, namespace=bag.namespace) as writer:
        for topic in _COPIED_TOPICS:
            for message in bag.raw_messages(topic):
                writer.write(topic, message.receive_ns, message.data)
        for signal in signals:
            writer.add_topic(signal.topic, graph.JOINT_STATE)
        stamps = np.concatenate([signal.stamps_ns for signal in signals])
        sources = np.repeat(np.arange(len(signals)), [len(signal.stamps_ns) for signal in signals])
        order = np.argsort(stamps, kind="stable")
        samples = [_rows_of(signal).rows(signal.stamps_ns, signal.values) for signal in signals]
        for first in range(0, total, _ROWS_AT_ONCE):
            # Among those of one signal the order of time is that of its rows.
            for k in order[first : first + _ROWS_AT_ONCE]:
                source = sources[k]
                writer.write(signals[source].topic, int(stamps[k]), next(samples[source]))
            progress(min(first + _ROWS_AT_ONCE, total) / total)
        return writer.message_count


def _rows_of(signal: _Signal) -> StampedRows:
    """Return what makes a JointState of any row of a signal."""
    types = BagTypes()
    # Displacements have the names of the markers, as on the graph.
    unit = "_m" if signal.topic == "beam/displacement" else ""
    names = [name.removesuffix(unit) for name in signal.columns]
    message = messages.displacement(types, 0, names, np.zeros(len(names)))
    # After the positions come the lengths of two empty arrays.
    return StampedRows(types.serialize(message, graph.JOINT_STATE), len(names), 8)
