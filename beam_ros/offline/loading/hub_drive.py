"""The rig's hub as the input of a record: what it did, on the host's clock, with its gaps filled from commands.

Which of its quantities that is goes with the structure: a model from motion to motion takes the measured position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beam_ident import InputSignal, Prior
from beam_ident.data.gaps import Bridge
from beam_ident.numerics.piecewise import Hold, PiecewisePolynomial
from beam_ident.sensing.commanded_motion import as_commanded
from beam_ident.sensing.still_noise import StillNoise
from beam_ros.arrays import FloatArray
from beam_ros.bags.errors import BagError
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import HubSamples
from beam_ros.errors import UsageError
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

_STRUCTURE_OF_MODE = {
    "acceleration": "base_motion",
    "velocity": "base_motion",
    "position": "base_motion",
    "effort": "force",
}
_INPUT_OF_STRUCTURE = {
    "base_motion": ("hub/measured", "positions", "m", "position"),
    "acceleration": ("hub/applied", "accelerations", "m/s^2", "acceleration"),
    "velocity": ("hub/applied", "velocities", "m/s", "velocity"),
    "force": ("hub/applied", "efforts", "N", "force"),
}
_NAMED_GAPS = 5
_MORE_NOISE = 1.5
_FINE_ENCODER = 2.5e-7  # m


@dataclass(frozen=True)
class RecordedDrive:
    """What drives an experiment: its signals, what they are, when time begins, what is known of their clock.

    There are several signals where the device restarted, or where a hole is longer than all that was recorded.
    """

    signals: tuple[InputSignal, ...]
    kind: str
    origin_ns: int
    clock_rate: Prior
    is_hub: bool


def hub_drive(
    bag: Bag, rig: Rig | None, structure: str, info: Mapping[str, Any], notes: list[str]
) -> RecordedDrive:
    """Read what the rig's hub did."""
    path, known = bag.path, rig or Rig.from_file()
    mode = str(info.get("mode", known.hub.command_mode))
    if mode not in _STRUCTURE_OF_MODE:
        raise BagError(
            f"{path}: excitation/info names the command mode {mode!r}; expected one of "
            f"{', '.join(_STRUCTURE_OF_MODE)}: give the structure with --structure and the rig with --rig-file"
        )
    _refuse_unrun_sequence(path, info, bag.sequence_states())
    chosen = _STRUCTURE_OF_MODE[mode] if structure == "auto" else structure
    if chosen not in _INPUT_OF_STRUCTURE:
        raise UsageError(
            f"structure {chosen} has a force of its own as input, and the hub is none; name it with --input "
            "TOPIC:FIELD"
        )
    topic, quantity, unit, kind = _INPUT_OF_STRUCTURE[chosen]
    bag.require(topic)
    bag.read(topic, "beam/displacement", "hub/clock_sync")
    samples = without_stray_batches(bag, bag.hub_samples(topic), notes)
    syncs = bag.clock_syncs()
    values = getattr(samples, quantity)
    if values is None:
        raise BagError(
            f"{path}: {topic} carries no {quantity}, which structure {chosen} needs; choose the structure that "
            f"goes with command mode {mode}"
        )
    origin_ns = int(samples.stamps_ns[0])
    _note_unreadable(samples, notes)
    commanded = bag.hub_samples("hub/applied") if bag.count("hub/applied") else None
    signals, rates = [], []
    for part in stretches_of(samples, origin_ns, notes):
        rate, known_rate = device_clock(samples, syncs, part)
        times, filled = on_every_tick(
            device_times(samples, part, rate, origin_ns), values[part], samples, rate
        )
        if np.count_nonzero(np.isfinite(filled)) < 2:
            continue
        _note_gaps(samples, part, origin_ns, notes)
        hold = known.hub.measured_hold if topic == "hub/measured" else known.hub.applied_hold
        drive = InputSignal("hub", unit, times, filled, hold)
        if topic == "hub/measured":
            drive = replace(
                drive, sigma=_encoder_noise(drive, rig.hub.encoder_resolution if rig else 0.0, notes)
            )
            is_needed = drive.sigma > _FINE_ENCODER or not np.all(np.isfinite(filled))
            if is_needed and commanded is not None:
                beside = in_stretch(commanded, samples, part)
                reference = _commanded_position(
                    commanded, beside, known.hub.applied_hold, times, origin_ns, rate
                )
                drive = _beside_commands(drive, filled, reference, notes)
        signals.append(drive)
        rates.append(known_rate)
    if not signals:
        raise BagError(
            f"{path}: {topic} has {np.count_nonzero(np.isfinite(values))} {quantity} that are numbers; expected two "
            "or more in a row. Record again with the hub running, or name another input with --input"
        )
    worst_rate = max(rates, key=lambda prior: prior.sd)
    return RecordedDrive(tuple(signals), kind, origin_ns, worst_rate, is_hub=True)


def _beside_commands(
    drive: InputSignal, filled: FloatArray, reference: FloatArray | None, notes: list[str]
) -> InputSignal:
    """Return a measured position without noise where the hub went as commanded, else with its gaps filled."""
    seen = np.isfinite(filled)
    led = None
    if reference is not None and drive.sigma > _FINE_ENCODER:
        led = as_commanded(drive, reference, seen)
    if led is None:
        return _filled_by_command(drive, drive.times_s, filled, reference)
    apart = float(np.std((drive.values - led.values)[seen]))
    notes.append(
        f"hub/measured differs from the motion that hub/applied makes by noise of {apart * 1e6:.2g} um alone: the "
        "hub went as it was led; its position is taken from hub/applied, without that noise"
    )
    return led


def _note_unreadable(samples: HubSamples, notes: list[str]) -> None:
    """Name messages that are no batches of samples."""
    if samples.unreadable.count:
        notes.append(
            f"{samples.topic}: {samples.unreadable.count} messages cannot be read and are left out (the first: "
            f"{samples.unreadable.first_reason})"
        )


def _refuse_unrun_sequence(
    path: AnyPath, info: Mapping[str, Any], states: Sequence[Mapping[str, Any]]
) -> None:
    """Name the hub's refusal where the recorded excitation never ran."""
    for state in states:
        if state.get("id") == info.get("sequence_id") and state.get("state") == "refused":
            raise BagError(
                f"{path}: the hub refused the excitation {state['id']} ({state.get('reason')}), so that nothing "
                "moved; mend that and record again"
            )


def _note_gaps(samples: HubSamples, part: slice, origin_ns: int, notes: list[str]) -> None:
    """Name the gaps in the samples that are used."""
    first, last = int(samples.stamps_ns[part.start]), int(samples.stamps_ns[part.stop - 1])
    gaps = [gap for gap in samples.gaps if first <= gap.start_ns and gap.end_ns <= last]
    if not gaps:
        return
    named = [
        f"{(gap.start_ns - origin_ns) * 1e-9:.3f} s ({(gap.end_ns - gap.start_ns) * 1e-6:.3g} ms)"
        for gap in gaps[:_NAMED_GAPS]
    ]
    more = f" and {len(gaps) - _NAMED_GAPS} more" if len(gaps) > _NAMED_GAPS else ""
    notes.append(
        f"{samples.topic} has {_counted(len(gaps), 'gap')}, {sum(gap.missing for gap in gaps)} samples lost: at "
        f"{', '.join(named)}{more}; what is on both sides was used"
    )


def _encoder_noise(drive: InputSignal, resolution: float, notes: list[str]) -> float:
    """Return the standard deviation of a measured position [m]: of its rounding, or more where it shows more."""
    of_rounding = resolution / math.sqrt(12.0)
    shown = StillNoise.of(drive).sigma
    if shown > _MORE_NOISE * of_rounding:
        notes.append(
            f"hub/measured has noise of {shown * 1e6:.2g} um, more than the {of_rounding * 1e6:.2g} um of an encoder "
            f"of {resolution * 1e6:.2g} um"
        )
    return max(shown, of_rounding)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _commanded_position(
    commanded: HubSamples, part: slice, hold: Hold, times: FloatArray, origin_ns: int, rate: float
) -> FloatArray | None:
    """Return the position that the commands make, up to a constant and a drift; NaN where they were lost.

    The device integrates what it is given itself, so that commands say what the hub did while nobody heard of it,
    but for the error of its servo.
    """
    quantities = ((commanded.positions, 0), (commanded.velocities, 1), (commanded.accelerations, 2))
    for values, n_integrals in quantities:
        if values is None or np.count_nonzero(np.isfinite(values[part])) < 2:
            continue
        at, every = on_every_tick(
            device_times(commanded, part, rate, origin_ns), values[part], commanded, rate
        )
        lost = np.isnan(every)
        signal = PiecewisePolynomial.from_samples(at, np.where(lost, 0.0, every), hold)
        for _ in range(n_integrals):
            signal = signal.antiderivative()
        known = (times >= at[0]) & (times <= at[-1]) & (np.interp(times, at, lost.astype(np.float64)) == 0.0)
        return np.where(known, signal(np.clip(times, at[0], at[-1])), np.nan)
    return None


def _filled_by_command(
    alone: InputSignal, times: FloatArray, values: FloatArray, reference: FloatArray | None
) -> InputSignal:
    """Return the input with every gap filled from its own samples or from the commands, whichever is surer."""
    if reference is None:
        return alone
    left = values - reference
    filled, gaps = np.array(alone.values), []
    for gap in alone.gaps:
        first = int(np.searchsorted(times, gap.start_s, side="right"))
        hole = slice(first, first + gap.missing)
        if np.all(np.isfinite(left[[first - 1, first + gap.missing]])) and not np.any(
            np.isnan(reference[hole])
        ):
            led = Bridge(times, left, first, gap.missing)
            if led.gap.sigma < gap.sigma:
                filled[hole], gap = led.values + reference[hole], led.gap
        gaps.append(gap)
    return replace(alone, values=filled, gaps=tuple(gaps))
