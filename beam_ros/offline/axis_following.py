"""How well the hub followed its commands in a bag: dry friction's lag, and what else strays.

A servo lags behind its command by what friction takes over its stiffness, to one side or the other. Lags in
proportion to speed and acceleration only weaken and delay a command; this one turns over with the direction, and
rings.
"""

from __future__ import annotations

import numpy as np

from beam_ident.shaping.known_beam import AxisErrors
from beam_ros.arrays import FloatArray
from beam_ros.bags.reading import Bag
from beam_ros.bags.signals import HubSamples
from beam_ros.process.remote_paths import AnyPath

_FAST = 0.2
"""Samples at more than this share of the largest speed: around a turn friction holds to neither side."""
_MIN_SAMPLES = 100
_SEEN = 3.0


def following_of_bag(path: AnyPath) -> AxisErrors | None:
    """Return how the hub of a bag strays from its commands; None where the bag does not tell.

    Parameters
    ----------
    path : Path or RemotePath -- a bag with ``hub/applied`` and ``hub/measured`` at the same ticks

    Raises
    ------
    BagError
        The bag is missing or damaged.

    Notes
    -----
    Measured less commanded position is fitted by ``sign(v)``, ``v`` and ``a`` of the command and the start's offset.
    A lag that does not stand out of the scatter is 0.
    """
    with Bag(path) as bag:
        if not (bag.count("hub/applied") and bag.count("hub/measured")):
            return None
        bag.read("hub/applied", "hub/measured")
        applied, measured = bag.hub_samples("hub/applied"), bag.hub_samples("hub/measured")
    common, at, also = np.intersect1d(applied.stamps_ns, measured.stamps_ns, return_indices=True)
    motion = _commanded(applied)
    if motion is None or measured.positions is None or len(common) < _MIN_SAMPLES:
        return None
    x, v, a = (values[at] for values in motion)
    apart = measured.positions[also] - x
    moving = np.isfinite(apart) & (np.abs(v) > _FAST * np.nanmax(np.abs(v)))
    if np.count_nonzero(moving) < _MIN_SAMPLES:
        return None
    apart = apart - np.nanmedian(apart[: _MIN_SAMPLES // 2])
    columns = np.stack([np.sign(v), v, a, np.ones_like(v)], axis=1)[moving]
    found = np.linalg.lstsq(columns, apart[moving], rcond=None)[0]
    scatter = float(np.std(apart[moving] - columns @ found))
    turns = 1 + np.count_nonzero(np.diff(np.sign(v[moving])))
    lag = max(0.0, -float(found[0]))
    is_seen = lag > _SEEN * scatter / np.sqrt(turns)
    return AxisErrors(lag if is_seen else 0.0, ((float(np.max(np.abs(a))), scatter),))


def _commanded(applied: HubSamples) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return position, velocity and acceleration of the command at its ticks, the position from its first."""
    period = applied.period_ns * 1e-9
    if not period:
        return None
    if applied.accelerations is not None:
        a = np.nan_to_num(applied.accelerations)
        ends = np.cumsum(a) * period
        v = ends - a * period
        return np.concatenate([[0.0], np.cumsum(0.5 * (v + ends))[:-1] * period]), v, a
    if applied.velocities is not None:
        v = np.nan_to_num(applied.velocities)
        return np.concatenate([[0.0], np.cumsum(v)[:-1] * period]), v, np.gradient(v, period)
    if applied.positions is not None:
        v = np.gradient(applied.positions, period)
        return applied.positions - applied.positions[0], v, np.gradient(v, period)
    return None
