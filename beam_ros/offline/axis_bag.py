"""A driven axis in a bag: the force on the hub and its position, on the host's clock.

The force is what the controller says that it applied, or measured where it tells nothing of that: both come with the
device's own ticks, and so does the position. What stands on the hub takes part in the motion: the clamped modes of
the rig's beam are handed over with the record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from beam_ident import AxisResult, InputSignal, OutputSignal, TimeRecord, identify_axis
from beam_ros.arrays import FloatArray
from beam_ros.bags.errors import BagError
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import HubSamples
from beam_ros.errors import UsageError
from beam_ros.files.formats import is_column_file
from beam_ros.offline.loading.hub_clock import (
    device_clock,
    device_times,
    in_stretch,
    on_every_tick,
    stretches_of,
)
from beam_ros.process.remote_paths import AnyPath
from beam_ros.rig.rig import Rig
from beam_ros.signals.stray_stamps import without_stray_batches

_RESOLVED = 0.5  # rad from tick to tick: a mode that turns by more is left out
_MAX_MODES = 3


def identify_axis_of(
    paths: Sequence[AnyPath],
    rig: Rig | None,
    notes: list[str],
    *,
    encoder: str = "hub",
    drive_mass: float | None = None,
) -> AxisResult:
    """Identify the axis of one or several bags.

    Parameters
    ----------
    paths : sequence of Path -- bags of one axis
    rig : Rig or None -- whose beam stands on it; None: nothing is known to swing on the axis
    notes : list of str -- what a reader should know is added here
    encoder, drive_mass -- of a compliant drive, as for ``beam_ident.identify_axis``

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
    if modes and encoder == "drive":
        notes.append(
            "the axis is identified without the beam's modes: an encoder on the drive does not measure how their "
            "base moves"
        )
        modes = []
    reference = "reference" if followed else None
    return identify_axis(
        records, force="force", reference=reference, modes=modes, encoder=encoder, drive_mass=drive_mass
    )


def refuse_files(paths: Sequence[AnyPath]) -> None:
    """Refuse files of columns, before any work is done on them.

    Raises
    ------
    UsageError
        One of the paths is such a file.
    """
    for path in paths:
        if is_column_file(path):
            raise UsageError(
                f"{path}: an axis is identified from hub/applied and hub/measured of a bag, which a file of columns "
                "lacks; leave --axis out, or give force and position to `identify_axis` in Python: "
                "TimeRecord.from_arrays(t, u={'force': f}, y={'hub': x}, units={'force': 'N', 'hub': 'm'})"
            )


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
    origin_ns = int(measured.stamps_ns[0])
    parts = stretches_of(measured, origin_ns, notes)
    part = parts[0]
    if len(parts) > 1:
        notes.append("the axis is taken from the longest of these stretches")
    rate, _ = device_clock(measured, syncs, part)

    def signal(samples: HubSamples, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        here = in_stretch(samples, measured, part)
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
    The rig file has no constant force: on a level axis what differs between the directions is dry friction, and no
    record tells the two apart. Friction below 0, which noise can leave of none, is 0. A simulated hub that follows
    its commands exactly feels no friction: where the rig has neither a servo nor forces for commands, it is left out.
    """
    beam = rig.beam_model().parameters
    found: dict[str, float | str] = {"hub.mass": result.moving_mass - (beam.total_mass - beam.hub_mass)}
    servo_hz = rig.simulation.servo_frequency
    if not servo_hz and rig.hub.command_mode != "effort":
        return found
    found["hub.command_mode"] = rig.hub.command_mode
    if servo_hz:
        found["simulation.servo_frequency"] = servo_hz
    apart = {
        "coulomb": result.resistance_forward - result.resistance_backward,
        "viscous": result.value("viscous_difference"),
    }
    for name, difference in apart.items():
        mean = max(result.value(name), 0.0)
        found[f"simulation.friction_{name}"] = mean
        found[f"simulation.friction_{name}_difference"] = min(max(difference, -2.0 * mean), 2.0 * mean)
    return found | {"simulation.friction_static": 0.0}


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
