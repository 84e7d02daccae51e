"""Noise of a measured input that nobody declared, from stretches of rest, or from the floor of its spectrum.

An encoder's noise passes through the model like the motion itself; residuals may look white all the same while poles
move by several standard deviations.  Nearly every record has stretches of rest, where what is measured is noise
alone: there the scatter about a straight line is that of the fourth differences, which let no slow motion pass.

Where nothing ever rests, the upper half of the spectrum tells: what moves falls off there, and white noise does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.noise.rounding import quantum

_WINDOW = 50  # samples
_MIN_REST = 200  # samples of rest: their deviation is known to 10 %
_AS_WHITE = 2.5  # scatter about a line over that of the differences, squared; of white noise 1 +- 0.4
_SPREAD = 3.0  # of the squared levels of stretches of rest
_SEGMENT, _MIN_SEGMENTS = 256, 8  # samples, each half of the one before; and how many of them
_FLAT = (
    1.4  # of the power in the two upper quarters of the band: 5 deviations of white noise in so few segments
)
_STEADY = 3.0  # of the floor's power in all segments but a tenth on each side
_SMALL = 0.01  # of the input's own deviation: more is no noise of a sensor, but the signal
_FEW_STEPS = 4.0  # of a counter within a window: an amplitude of two errs by up to 13 %
_DITHERED = 0.25  # of a step: what is seen in rest of noise that was there before the rounding
_SMALL_IN_REST = 0.05  # the same where nothing else was there to see


@dataclass(frozen=True)
class StillNoise:
    """Noise found in rest, or beneath the motion.

    Attributes
    ----------
    sigma : float -- standard deviation, in the input's unit; 0 where none was found
    still_s : float -- how long the input stood still [s]; 0 where it did not
    is_behind : bool -- whether it was seen in what it leaves at the outputs, else it is the floor of the spectrum
    """

    sigma: float = 0.0
    still_s: float = 0.0
    is_behind: bool = False

    @staticmethod
    def of(drive: InputSignal) -> StillNoise:
        """Return the noise of an input that is measured; a held command has none."""
        if drive.hold == "zoh":
            return StillNoise()
        found = StillNoise._in_rest(drive)
        return found if found.sigma > 0.0 else StillNoise(_floor(drive.values))

    @staticmethod
    def _in_rest(drive: InputSignal) -> StillNoise:
        values = drive.values
        if len(values) < _MIN_REST:
            return StillNoise()
        level, is_white = _scatter(_in_windows(values))
        if not np.any(is_white):
            return StillNoise()
        # A signal that is itself as rough as noise is louder than rest: the quietest stretches decide.
        quiet = float(np.median(np.sort(level[is_white])[: max(int(np.sum(is_white)) // 3, 1)]))
        still = is_white & (level <= _SPREAD * quiet)
        # An encoder that stands between two counts shows nothing of its rounding: that is known from its steps.
        sigma = max(math.sqrt(float(np.mean(level[still]))), counted_step(values) / math.sqrt(12.0))
        count = int(np.sum(still)) * _WINDOW
        if count < _MIN_REST or not _rounding(values) < sigma < _SMALL_IN_REST * float(np.std(values)):
            return StillNoise()
        return StillNoise(sigma, count * float(np.median(np.diff(drive.times_s))))


def _in_windows(values: FloatArray) -> FloatArray:
    """Return values in rows of a window each, without what is left at the end."""
    n_windows = len(values) // _WINDOW
    return values[: n_windows * _WINDOW].reshape(n_windows, _WINDOW)


def _scatter(windows: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the variance of white noise in every window, and whether there is nothing else about a line."""
    # Fourth differences of white noise have 1 + 16 + 36 + 16 + 1 = 70 times its variance.
    level = np.mean(np.square(np.diff(windows, 4, axis=1)), axis=1) / 70.0
    line = np.linalg.qr(np.stack([np.ones(_WINDOW), np.arange(_WINDOW)], axis=1))[0]
    about = np.sum(np.square(windows - windows @ line @ line.T), axis=1) / (_WINDOW - 2)
    return level, about <= _AS_WHITE * level + (1e-13 * float(np.max(np.abs(windows)))) ** 2


def counted_step(values: FloatArray) -> float:
    """Return the step in which a motion was counted, 0 where there is none, or where the steps are the input's own.

    Notes
    -----
    A motion changes its count at any sample, and does not stand still before and after it has moved by several.  What
    is held for some samples changes at every so-manieth only, or jumps and stands.
    """
    step = quantum(values)
    moves = np.round(np.diff(values) / step).astype(np.int64) if step else np.zeros(3, dtype=np.int64)
    changes = np.flatnonzero(moves)
    if len(changes) < 2 or np.gcd.reduce(np.diff(changes)) > 1:
        return 0.0
    jumps = np.abs(moves[1:-1]) > 1
    alone = jumps & (moves[:-2] == 0) & (moves[2:] == 0)
    return 0.0 if 2 * np.count_nonzero(alone) > np.count_nonzero(jumps) else step


def counted_input_warning(drive: InputSignal) -> str:
    """Return that a measured input moves by few of the steps in which it is counted, or an empty string.

    Notes
    -----
    Of a sine of amplitude A that is rounded to steps of q, the first harmonic errs by up to ``0.37 (q / A)^1.5``.
    What passes many steps, or has noise before it is rounded, has errors like noise, and the rest has not.
    """
    step = counted_step(drive.values) if drive.hold != "zoh" else 0.0
    windows = _in_windows(drive.values)
    if not step or not len(windows):
        return ""
    swings = np.ptp(windows, axis=1) / step
    level, is_still = _scatter(windows)
    few = (swings > 0.5) & (swings < _FEW_STEPS) & ~is_still
    is_dithered = np.any(is_still) and float(np.median(level[is_still])) > (_DITHERED * step) ** 2
    if is_dithered or not np.any(few):
        return ""
    lasted = np.count_nonzero(few) * _WINDOW * float(np.median(np.diff(drive.times_s)))
    return (
        f"Rounding: {drive.name} is counted in steps of {step:.3g} {drive.unit}, and for {lasted:.3g} s it moves by "
        f"less than {_FEW_STEPS:.0f} of them at a time. There its errors follow the motion, and are no noise that "
        "sigma could state. Count more finely, move further where it is fast, or give the commanded motion as input."
    )


def _floor(values: FloatArray) -> float:
    """Return the standard deviation of white noise beneath a motion, 0 where the spectrum has no flat end."""
    if len(values) < (_MIN_SEGMENTS + 1) * _SEGMENT // 2:
        return 0.0
    segments = np.lib.stride_tricks.sliding_window_view(values, _SEGMENT)[:: _SEGMENT // 2]
    # Differences first: of a fast and large motion too much would leak through the window.
    window = np.hanning(_SEGMENT - 4)
    power = np.square(np.abs(np.fft.rfft(np.diff(segments, 4, axis=1) * window, axis=1)))
    lines = np.pi * np.arange(power.shape[1]) / (power.shape[1] - 1)
    quarter = len(lines) // 4
    upper = power[:, 2 * quarter : -1] / float(window @ window)
    upper /= (2.0 * np.sin(0.5 * lines[2 * quarter : -1])) ** 8
    third, fourth = float(np.mean(upper[:, :quarter])), float(np.mean(upper[:, quarter:]))
    levels = np.quantile(np.mean(upper, axis=1), (0.1, 0.5, 0.9))
    sigma = math.sqrt(max(third + fourth, 0.0) / 2.0)
    is_noise = third < _FLAT * fourth and fourth < _FLAT * third and levels[2] < _STEADY * levels[0]
    return sigma if is_noise and _rounding(values) < sigma < _SMALL * float(np.std(values)) else 0.0


def _rounding(values: FloatArray) -> float:
    return 1e-12 * float(np.max(np.abs(values)))


def with_found_noise(
    records: list[TimeRecord], input_names: Sequence[str]
) -> tuple[list[TimeRecord], dict[int, StillNoise]]:
    """Return records whose input has the noise that its rest shows, where it states none; and of which it was found.

    Parameters
    ----------
    records : list of TimeRecord
    input_names : sequence of str -- which inputs are used; what one shows stands for all
    """
    result, found = [], {}
    for index, record in enumerate(records):
        inputs = list(record.inputs)
        for place, drive in enumerate(inputs):
            if drive.sigma == 0.0 and drive.name in input_names:
                noise = StillNoise.of(drive)
                if noise.sigma > 0.0:
                    inputs[place] = replace(drive, sigma=noise.sigma)
                    found[index] = noise
        result.append(replace(record, inputs=tuple(inputs)) if index in found else record)
    return result, found


def found_noise_warning(drive: InputSignal, noise: StillNoise, treatment: str) -> str:
    """Return what must be known of noise that nobody declared.

    Parameters
    ----------
    drive : InputSignal
    noise : StillNoise
    treatment : str -- what was done about it
    """
    where = "seen as the flat end of its spectrum, for it never stood still"
    if noise.still_s > 0.0:
        where = f"seen while it stood still for {noise.still_s:.3g} s"
    elif noise.is_behind:
        where = (
            "seen in what it leaves at the outputs, as would be a disturbance that acts where the input does"
        )
    return f"Input {drive.name} has noise that nobody declared: {noise.sigma:.2g} {drive.unit}, {where}. {treatment}"
