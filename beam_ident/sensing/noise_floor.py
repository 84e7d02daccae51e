"""The level of white noise beneath a signal, from the quietest lines of its spectrum: no model is needed.

What moves fills some lines of a spectrum, white noise all of them alike. The power of a line of noise is distributed
exponentially, so that the quietest quarter of all lines ends at ``-ln(3/4)`` times the mean power of the noise.
"""

from __future__ import annotations

import math

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.noise.rounding import quantum

_QUIETEST = 0.25
_FEW = 32  # samples
_HOLE = 1.5  # usual intervals


def noise_floor(times_s: FloatArray, values: FloatArray) -> float:
    """Return the standard deviation of white noise that a signal can have at most, NaN where it is too short.

    Parameters
    ----------
    times_s : ndarray, shape (n,) -- stamps [s]
    values : ndarray, shape (n,) -- without NaN

    Notes
    -----
    Of the longest stretch without a hole. A signal that fills more than three quarters of its band is not told from
    noise: the floor is an upper bound. Rounding is counted even where it leaves every value the same.
    """
    if len(values) < _FEW:
        return math.nan
    steps = np.diff(times_s)
    edges = [0, *(np.flatnonzero(steps > _HOLE * np.median(steps)) + 1).tolist(), len(values)]
    longest = int(np.argmax(np.diff(edges)))
    piece = values[edges[longest] : edges[longest + 1]]
    if len(piece) < _FEW:
        return math.nan
    line = np.linspace(-1.0, 1.0, len(piece))
    # A window whose side lobes fall fast: of a large slow motion nothing may leak into the quiet lines.
    window = np.blackman(len(piece))
    power = np.square(np.abs(np.fft.rfft(window * (piece - np.polyval(np.polyfit(line, piece, 1), line)))))
    quiet = float(np.quantile(power[1:-1], _QUIETEST)) / -math.log(1.0 - _QUIETEST)
    return max(math.sqrt(quiet / float(window @ window)), quantum(values) / math.sqrt(12.0))
