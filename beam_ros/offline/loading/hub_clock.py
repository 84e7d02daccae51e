"""The hub's samples on the host's clock: ticks are counted, and lie on one line through the clock comparisons.

Each restart of the device begins a clock and a zero of its own: an epoch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from beam_ident import Prior
from beam_ros.arrays import FloatArray
from beam_ros.bags.errors import BagError
from beam_ros.bags.signals import OWN_STAMPS_GAP, HubSamples
from beam_ros.hub.clock_mapping import fit_affine

_CLOSE = 0.5  # of the device's period
_NAMED = 5
_AROUND_NS = 1_000_000_000  # what is commanded may begin before it is measured, and end after


def stretches_of(samples: HubSamples, origin_ns: int, notes: list[str]) -> tuple[slice, ...]:
    """Return which samples go together, the most first, and say where there are several such stretches.

    Raises
    ------
    BagError
        Samples stand closer than the device takes them: those of two devices, or of two recordings.
    """
    is_close = np.diff(samples.stamps_ns) < _CLOSE * samples.period_ns
    close = np.flatnonzero(is_close & (np.diff(samples.epochs) == 0))
    if len(close):
        raise BagError(
            f"{samples.topic}: {len(close)} of {len(samples.stamps_ns)} samples follow the one before within less "
            f"than half of the device's period of {samples.period_ns * 1e-6:g} ms, first at "
            f"{(samples.stamps_ns[close[0]] - origin_ns) * 1e-9:.3f} s; expected one device in one recording: two "
            "publish on this topic, or two recordings were put into one bag. Give one of them"
        )
    stretches = samples.stretches
    if len(stretches) > 1:
        restarts = int(np.count_nonzero(np.diff(samples.epochs)))
        lengths = ", ".join(str(own.stop - own.start) for own in stretches[:_NAMED])
        more = f" and {len(stretches) - _NAMED} more" if len(stretches) > _NAMED else ""
        notes.append(
            f"{samples.topic}: {len(stretches)} stretches of {lengths}{more} samples, for the device restarted "
            f"{restarts} times and {len(stretches) - 1 - restarts} holes are longer than all that was recorded"
        )
    return tuple(sorted(stretches, key=lambda own: own.start - own.stop))


def in_stretch(samples: HubSamples, other: HubSamples, part: slice) -> slice:
    """Return which samples of a topic were taken while another one's stretch was, on the same clock."""
    first, last = other.stamps_ns[part.start], other.stamps_ns[part.stop - 1]
    own = np.flatnonzero(
        (samples.epochs == other.epochs[part.start])
        & (samples.stamps_ns >= first - _AROUND_NS)
        & (samples.stamps_ns <= last + _AROUND_NS)
    )
    return slice(int(own[0]), int(own[-1]) + 1) if len(own) else slice(0, 0)


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
