"""A driven axis in a bag: the force on the hub and its position, on the host's clock.

The force is what the controller says that it applied, or measured where it tells nothing of that: both come with the
device's own ticks, and so does the position. What stands on the hub takes part in the motion: the clamped modes of
the rig's beam are handed over with the record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from beam_ident import AxisResult, InputSignal, OutputSignal, Prior, TimeRecord, identify_axis
from beam_ros.arrays import FloatArray
from beam_ros.bags.errors import BagError
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import OWN_STAMPS_GAP, HubSamples
from beam_ros.hub.clock_mapping import fit_affine
from beam_ros.process.remote_paths import AnyPath
from beam_ros.rig.rig import Rig
from beam_ros.signals.stray_stamps import without_stray_batches

_RESOLVED = 0.5  # rad from tick to tick: a mode that turns by more is left out
_MAX_MODES = 3


def longest_epoch(samples: HubSamples, notes: list[str]) -> slice:
    """Choose the samples between two restarts of the device that are most: each restart begins another clock."""
    borders = [0, *(np.flatnonzero(np.diff(samples.epochs)) + 1).tolist(), len(samples.epochs)]
    longest = int(np.argmax(np.diff(borders)))
    first, last = borders[longest], borders[longest + 1]
    if len(borders) > 2:
        notes.append(
            f"{samples.topic}: the device restarted {len(borders) - 2} times; the longest time without a restart was "
            f"used, {last - first} of {len(samples.epochs)} samples, since each restart begins a clock and a zero of "
            "its own"
        )
    return slice(first, last)


def on_every_tick(
    times: FloatArray, values: FloatArray, samples: HubSamples, rate: float
) -> tuple[FloatArray, FloatArray]:
    """Return the samples with a stamp for every tick between the first and the last, NaN where one was lost."""
    seen = np.flatnonzero(np.isfinite(values))
    if len(seen) < 2:
        return times, values
    times, values = times[seen[0] : seen[-1] + 1], values[seen[0] : seen[-1] + 1]
    steps = np.diff(times)
    period_s = samples.period_ns * rate * 1e-9 or float(np.median(steps))
    widest = 1.5 if samples.period_ns else OWN_STAMPS_GAP
    # How many are missing before every sample but the first.
    missing = np.where(steps > widest * period_s, np.maximum(np.rint(steps / period_s), 2.0) - 1.0, 0.0)
    places = np.arange(len(times)) + np.concatenate([[0], np.cumsum(missing.astype(np.intp))])
    every = np.arange(places[-1] + 1)
    filled = np.full(len(every), np.nan)
    filled[places] = values
    return np.interp(every, places, times), filled


def device_clock(samples: HubSamples, syncs: Sequence[Any], part: slice) -> tuple[float, Prior]:
    """Return host seconds per device second, and what is known of the rate that remains."""
    epoch = int(samples.epochs[part.start])
    own = [sync for sync in syncs if sync.epoch == epoch]
    if len(own) < 3:
        return 1.0, Prior(0.0, 50e-6)
    line = fit_affine(own)
    is_exact = all(sync.rtt_ns == 0 for sync in own)
    return line.rate, Prior(0.0, 0.0 if is_exact else math.sqrt(float(line.covariance[1, 1])))


def device_times(samples: HubSamples, part: slice, rate: float, origin_ns: int) -> FloatArray:
    """Put the samples on the host's clock: whole ticks on one line, which the stamps place.

    The stamps of batches wander by microseconds as the driver slews its map; ticks are counted exactly. Samples
    without a tick, which a host asked for one by one, lie where their stamps say.
    """
    stamps_ns = samples.stamps_ns[part]
    if samples.period_ns == 0:
        return np.asarray((stamps_ns - origin_ns) * 1e-9)
    ticks = np.concatenate([[0], np.cumsum(np.rint(np.diff(stamps_ns) / (samples.period_ns * rate)))])
    line = ticks * (samples.period_ns * rate)
    offset = float(np.mean((stamps_ns - origin_ns) - line))
    return np.asarray((line + offset) * 1e-9)


def identify_axis_of(paths: Sequence[AnyPath], rig: Rig | None, notes: list[str]) -> AxisResult:
    """Identify the axis of one or several bags.

    Parameters
    ----------
    paths : sequence of Path -- bags of one axis
    rig : Rig or None -- whose beam stands on it; None: nothing is known to swing on the axis
    notes : list of str -- what a reader should know is added here

    Raises
    ------
    BagError
        A bag has no force on the hub.
    IdentificationError
        The axis never moved, or not in both directions.
    """
    records = [axis_record(path, notes) for path in paths]
    followed = all(len(record.inputs) > 1 for record in records)
    if not followed:
        records = [TimeRecord(one.inputs[:1], one.outputs, one.start_ns, one.name) for one in records]
    modes = [] if rig is None else _modes_on_hub(rig, records[0].inputs[0].period_s or 0.0)
    reference = "reference" if followed else None
    return identify_axis(records, force="force", reference=reference, modes=modes)


def axis_record(path: AnyPath, notes: list[str]) -> TimeRecord:
    """Read force, position and, where the hub was told positions, these as the reference.

    Parameters
    ----------
    path : Path or RemotePath -- the bag
    notes : list of str -- gaps and restarts are named here

    Raises
    ------
    BagError
        The bag has no measured positions, or no force.
    """
    with Bag(path) as bag:
        bag.require("hub/measured")
        bag.read("hub/applied", "hub/measured", "hub/clock_sync")
        measured = without_stray_batches(bag, bag.hub_samples("hub/measured"), notes)
        applied = bag.hub_samples("hub/applied") if bag.count("hub/applied") else None
        syncs = bag.clock_syncs()
    if measured.positions is None:
        raise BagError(
            f"{path}: hub/measured carries no positions, which an axis is identified from; record them"
        )
    part = longest_epoch(measured, notes)
    rate, _ = device_clock(measured, syncs, part)
    origin_ns = int(measured.stamps_ns[part.start])
    epoch = int(measured.epochs[part.start])

    def signal(samples: HubSamples, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        own = np.flatnonzero(samples.epochs == epoch)
        here = slice(int(own[0]), int(own[-1]) + 1)
        return on_every_tick(device_times(samples, here, rate, origin_ns), values[here], samples, rate)

    sources = [samples for samples in (applied, measured) if samples is not None and _has(samples.efforts)]
    if not sources:
        raise BagError(
            f"{path}: neither hub/applied nor hub/measured carries a force, which an axis is identified from; record "
            "one with hub.command_mode effort, or of a controller that tells its effort"
        )
    assert sources[0].efforts is not None
    inputs = [InputSignal("force", "N", *signal(sources[0], sources[0].efforts), "zoh")]
    if applied is not None and applied.positions is not None and _has(applied.positions):
        inputs.append(InputSignal("reference", "m", *signal(applied, applied.positions), "linear"))
    times, positions = signal(measured, measured.positions)
    return TimeRecord(tuple(inputs), (OutputSignal("position", "m", times, positions),), origin_ns, path.name)


def rig_values(result: AxisResult, rig: Rig) -> dict[str, float | str]:
    """Return what an axis says of the rig's parameters, by their names.

    Parameters
    ----------
    result : AxisResult -- in newtons
    rig : Rig -- whose beam is taken from the moving mass

    Notes
    -----
    The rig file has one dry and one viscous friction for both directions: their means. It has no constant force,
    which a level axis lacks. Friction below 0, which noise can leave of none, is 0. A simulated hub that follows its
    commands exactly feels no friction: where the rig has neither a servo nor forces for commands, it is left out.
    """
    beam = rig.beam_model().parameters
    found: dict[str, float | str] = {"hub.mass": result.moving_mass - (beam.total_mass - beam.hub_mass)}
    servo_hz = rig.simulation.servo_frequency
    if not servo_hz and rig.hub.command_mode != "effort":
        return found
    found["hub.command_mode"] = rig.hub.command_mode
    if servo_hz:
        found["simulation.servo_frequency"] = servo_hz
    return found | {
        "simulation.friction_coulomb": max(result.value("coulomb"), 0.0),
        "simulation.friction_viscous": max(result.value("viscous"), 0.0),
        "simulation.friction_static": 0.0,
    }


def rig_file_of(values: Mapping[str, float | str]) -> str:
    """Return the text of a rig file with these parameters alone, for ``--params-file`` and ``--rig-file``."""
    lines = ["/**:", "  ros__parameters:"]
    group = ""
    for name, value in values.items():
        own, _, leaf = name.partition(".")
        if own != group:
            lines.append(f"    {own}:")
        group = own
        lines.append(f"      {leaf}: {value if isinstance(value, str) else _number(value)}")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """Return a number as YAML knows it: to YAML 1e-07 is a word, and 1.0e-07 a number."""
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _has(values: FloatArray | None) -> bool:
    return values is not None and int(np.count_nonzero(np.isfinite(values))) > 1


def _modes_on_hub(rig: Rig, period_s: float) -> list[tuple[float, float]]:
    """Return the clamped modes of the rig's beam that the ticks resolve."""
    model = rig.beam_model()
    pairs = zip(model.natural_frequencies, model.damping_ratios, strict=True)
    kept = [(float(omega), float(zeta)) for omega, zeta in pairs if omega * period_s < _RESOLVED]
    return kept[:_MAX_MODES]
