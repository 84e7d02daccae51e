"""Whether a measured motion is the commanded one and white noise, so that the command says better what moved.

A device that integrates its commands itself, as a stepper does, goes where they lead. A coarse or noisy encoder
beside it knows less about the motion than the commands do: noise on an input passes through the model like
the motion, hides weak modes, and biases poles where it is ignored. What the encoder can still do is to
contradict. Where it does not, the motion is taken from the commands.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.data.records import InputSignal
from beam_ident.noise.rounding import quantum
from beam_ident.noise.scores import Whiteness

_MIN_SAMPLES = 200
_LEVEL = 1e-3  # how often a motion that is the commanded one is not believed to be, for each of two tests
_N_SLOW = 8  # waves, the last of five periods: a slip in mid-record is one of them nearly
_COUNTS = 1.01  # quanta between the largest and the smallest difference of rounding alone


def as_commanded(
    drive: InputSignal, reference: FloatArray, seen: BoolArray | None = None
) -> InputSignal | None:
    """Return an input without noise, moving as commanded, or None where the measurement contradicts.

    Parameters
    ----------
    drive : InputSignal -- the measured motion, in regular steps
    reference : ndarray, shape (n_samples,)
        The motion that the commands make at the same instants, up to a constant and a drift; NaN where unknown.
    seen : ndarray of bool, shape (n_samples,), or None -- where it was measured; None: everywhere

    Notes
    -----
    Either all differences are rounding: they span one count at most. Or they are white (Ljung and Box), and
    neither the motion nor its speed, its acceleration or slow waves are in them: gain, delay, servo are as commanded,
    and nothing slipped. The constant and the drift, which no command tells, are the measured ones. What was not
    measured is known all the same.
    """
    seen = np.ones(len(reference), dtype=bool) if seen is None else seen
    if drive.period_s is None or np.count_nonzero(seen) < _MIN_SAMPLES or not np.all(np.isfinite(reference)):
        return None
    apart = (drive.values - reference)[seen]
    if np.ptp(apart) <= _COUNTS * quantum(drive.values[seen]):
        motion = reference + 0.5 * (np.max(apart) + np.min(apart))
    else:
        line = np.stack([np.ones(len(reference)), np.linspace(-1.0, 1.0, len(reference))], axis=1)
        motion = reference + line @ np.linalg.lstsq(line[seen], apart, rcond=None)[0]
        if not _is_noise((drive.values - motion)[seen], motion, line, seen):
            return None
    gaps = tuple(replace(gap, sigma=0.0, errors=np.zeros_like(gap.errors)) for gap in drive.gaps)
    return replace(drive, values=motion, sigma=0.0, gaps=gaps)


def _is_noise(left: FloatArray, motion: FloatArray, line: FloatArray, seen: BoolArray) -> bool:
    """Return whether differences are white and hold nothing of the motion, its derivatives, and slow waves."""
    if Whiteness.of(left).p_value <= _LEVEL:
        return False
    speed = np.gradient(motion)
    half_turns = np.pi * np.linspace(0.0, 1.0, len(motion))
    slow = [np.cos(k * half_turns) for k in range(2, 2 + _N_SLOW)]
    columns = np.stack([motion, speed, np.gradient(speed), *slow], axis=1)[seen]
    columns -= line[seen] @ np.linalg.lstsq(line[seen], columns, rcond=None)[0]
    size = np.linalg.norm(columns, axis=0)
    basis = np.linalg.qr(columns[:, size > 0.0] / size[size > 0.0])[0]
    explained = float(np.sum(np.square(basis.T @ left)) / np.mean(np.square(left)))
    return bool(chi_squared_sf(max(basis.shape[1], 1), explained) > _LEVEL)
