"""What the theory advises before an experiment: where to put markers, how fast to film, what to sweep."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from beam_model.arrays import FloatArray
from beam_model.errors import BeamParameterError
from beam_model.galerkin.model import BeamModel

# Frames per period of the highest wanted mode: the sampling theorem's 2 with room for a filter's slope.
_FRAMES_PER_PERIOD = 2.5
_GRID_POINTS = 61


@dataclass(frozen=True)
class ExperimentAdvice:
    """Suggestions for identifying the first modes of a beam.

    Attributes
    ----------
    n_modes : int
        How many modes the suggestions are for.
    marker_heights : ndarray, shape (n_markers,)
        Where every wanted mode is seen well by at least one marker [m].
    visibility : ndarray, shape (n_modes,)
        Of each mode in those markers together, root of the sum of squares over its largest amplitude; 1 is a
        marker at the antinode.
    frame_rate : float
        Above it no wanted mode aliases [Hz]. A slower camera with exact stamps still serves a direct fit.
    excitation_band : tuple of float
        Lowest and highest frequency to sweep [Hz].
    half_power_bandwidths : ndarray, shape (n_modes,)
        2 zeta f of each mode [Hz].
    settling_time : float
        Until the slowest mode has decayed to a thousandth [s].
    """

    n_modes: int
    marker_heights: FloatArray
    visibility: FloatArray
    frame_rate: float
    excitation_band: tuple[float, float]
    half_power_bandwidths: FloatArray
    settling_time: float


def relative_amplitudes(model: BeamModel, heights: ArrayLike) -> FloatArray:
    """Return |phi_i(z)| over the mode's largest amplitude, shape (n_heights, n_modes)."""
    grid = np.linspace(0.0, model.parameters.length, 40 * model.n_modes + 1)
    largest = np.abs(model.shape(grid)).max(axis=0)
    return np.asarray(np.abs(model.shape(heights)) / largest)


def node_heights(model: BeamModel, mode: int) -> FloatArray:
    """Return where a mode does not move, but for the clamp, lowest first [m].

    Parameters
    ----------
    model : BeamModel
    mode : int
        Index from 0: mode k of a bare cantilever has k nodes.
    """
    if not 0 <= mode < model.n_modes:
        raise BeamParameterError("mode", mode, "", f"an index from 0 to {model.n_modes - 1}")
    length = model.parameters.length
    grid = np.linspace(0.01 * length, length, 40 * model.n_modes + 1)
    values = model.shape(grid)[:, mode]
    return np.array(
        [
            brentq(lambda z: float(model.shape([z])[0, mode]), grid[k], grid[k + 1], xtol=1e-9)
            for k in np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))
        ]
    )


def suggest_marker_heights(
    model: BeamModel, n_modes: int, n_markers: int = 2, *, lowest: float = 0.0, separation: float = 0.02
) -> FloatArray:
    """Return the heights from which the least visible of the first modes is seen best, shape (n_markers,) [m].

    Parameters
    ----------
    model : BeamModel
    n_modes : int
        How many modes are wanted.
    n_markers : int
        1 to 3 markers; one on or near the hub, which shows the hub's motion, comes on top.
    lowest : float
        Lowest height allowed [m].
    separation : float
        Least distance between two markers [m].

    Notes
    -----
    Maximises min_i sqrt(sum_k phi_i(z_k)^2) / max |phi_i| over a grid.
    """
    if not 1 <= n_modes <= model.n_modes:
        raise BeamParameterError("n_modes", n_modes, "", f"from 1 to the model's {model.n_modes}")
    if not 1 <= n_markers <= 3:
        raise BeamParameterError("n_markers", n_markers, "", "1 to 3 markers besides the one at the hub")
    length = model.parameters.length
    if not 0.0 <= lowest < length:
        raise BeamParameterError("lowest", lowest, "m", f"from 0 to below the beam's length of {length:g} m")
    grid = np.linspace(lowest, length, _GRID_POINTS)
    chosen = np.array(list(combinations(range(_GRID_POINTS), n_markers)))
    if n_markers > 1:
        chosen = chosen[np.all(np.diff(grid[chosen], axis=1) >= separation - 1e-12, axis=1)]
    if chosen.size == 0:
        raise BeamParameterError(
            "separation", separation, "m", f"small enough for {n_markers} markers on {length - lowest:g} m"
        )
    squares = relative_amplitudes(model, grid)[:, :n_modes] ** 2
    score = np.sum(squares[chosen], axis=1).min(axis=1)
    # Of equally good choices the highest on the beam, where displacements are largest.
    best = np.flatnonzero(score >= score.max() * (1.0 - 1e-9))[-1]
    return np.asarray(grid[chosen[best]])


def aliases(frequencies_hz: ArrayLike, frame_rate: float) -> FloatArray:
    """Return where frequencies [Hz] appear in frames taken at ``frame_rate`` [Hz], between 0 and half of it."""
    if not frame_rate > 0.0:
        raise BeamParameterError("frame_rate", frame_rate, "Hz", "above 0")
    f = np.asarray(frequencies_hz, dtype=np.float64)
    return np.asarray(np.abs(f - frame_rate * np.round(f / frame_rate)))


def advise(
    model: BeamModel, n_modes: int = 3, n_markers: int = 2, *, lowest_marker: float = 0.0
) -> ExperimentAdvice:
    """Return suggestions for identifying the first ``n_modes`` modes.

    Parameters
    ----------
    model : BeamModel
    n_modes, n_markers, lowest_marker
        See ``suggest_marker_heights``.

    Notes
    -----
    The band runs from a third of the first frequency, where the beam still follows the hub, to a fifth above the
    last one, so that its whole resonance is swept; but not into the next mode.
    """
    heights = suggest_marker_heights(model, n_modes, n_markers, lowest=lowest_marker)
    visibility = np.sqrt(np.sum(relative_amplitudes(model, heights)[:, :n_modes] ** 2, axis=0))
    f = model.natural_frequencies / (2.0 * np.pi)
    zeta = model.damping_ratios
    top = 1.2 * f[n_modes - 1]
    if n_modes < model.n_modes:
        top = min(top, float(np.sqrt(f[n_modes - 1] * f[n_modes])))
    decay = float(np.min(-model.poles.real[:n_modes]))
    return ExperimentAdvice(
        n_modes=n_modes,
        marker_heights=heights,
        visibility=visibility,
        frame_rate=float(_FRAMES_PER_PERIOD * f[n_modes - 1]),
        excitation_band=(float(f[0] / 3.0), float(top)),
        half_power_bandwidths=2.0 * zeta[:n_modes] * f[:n_modes],
        settling_time=float(np.log(1000.0) / decay) if decay > 0.0 else float("inf"),
    )
