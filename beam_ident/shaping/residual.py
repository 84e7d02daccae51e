"""The swing that a move leaves, before it is made: with an interval, and the probability that it is too much.

The swing of an output is the sum of its modes' amplitudes when the command has ended: as far as the marker can get
from its place of rest. It is linear in the command, so that it follows in closed form for every beam that the model
allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.numerics.recursions import one_pole
from beam_ident.shaping.command import Move
from beam_ident.shaping.known_beam import KnownBeam

LEVEL = 0.95
ALLOWED = 0.05
"""With at most this probability may a chosen move leave more than the aim."""
_ROUNDS = 3  # each makes the error of the last one smaller by the share of the forces in the linear ones


@dataclass(frozen=True, eq=False)
class Residual:
    """Predicted swing after a move.

    Attributes
    ----------
    output_names : tuple of str
    nominal : ndarray, shape (n_outputs,) -- of the model as it stands, on an axis that follows exactly [m]
    median, low, high : ndarray, shape (n_outputs,) -- median and 95 % interval [m]
    swings : ndarray, shape (n_draws, n_outputs) -- [m]
    """

    output_names: tuple[str, ...]
    nominal: FloatArray
    swings: FloatArray

    @property
    def median(self) -> FloatArray:
        """Median of the swing, shape (n_outputs,) [m]."""
        return np.median(self.swings, axis=0)

    @property
    def interval(self) -> tuple[FloatArray, FloatArray]:
        """Ends of the 95 % interval, each of shape (n_outputs,) [m]."""
        low, high = np.quantile(self.swings, [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0], axis=0)
        return low, high

    def probability_above(self, aim: float) -> float:
        """Return how probable it is that any output swings by more than an aim [m]."""
        return float(np.mean(np.max(self.swings, axis=1) > aim))

    @property
    def worst(self) -> int:
        """Index of the output that swings most."""
        return int(np.argmax(self.median))


def predict_residual(move: Move, beam: KnownBeam, noise: FloatArray | None = None) -> Residual:
    """Return the swing that a move leaves at every output.

    Parameters
    ----------
    move : Move
    beam : KnownBeam
    noise : ndarray, shape (n_outputs, n_modes), optional
        Standard deviation of both parts of a measured modal amplitude [m]: the interval is then one for the swing
        that a camera will measure.

    Notes
    -----
    With the end phasor E_i of ``Move.end_phasors`` and the residue r_ij the swing is ``sum_i |r_ij E_i| / Im(p_i)``.
    Dry friction holds the hub behind its command as play does: each step S of that at a time t adds
    ``S p exp(p (t_end - t))``. Deviations s of the hub that keep their phase for a part of a period add a normal
    phasor of variance ``s^2 omega^3 T / 4`` in both parts. Stiffening and drag are small beside the linear forces:
    they are one more drive, computed from the motion in a few rounds.
    """
    draws = beam.draws
    phasors = move.end_phasors(draws.poles)
    phasors = phasors + _of_friction(move, beam) + _of_scatter(move, beam) + _of_law(move, beam)
    amplitudes = draws.shares * (phasors / draws.poles.imag)[:, None, :]
    if noise is not None:
        rng = np.random.default_rng([beam.seed, 1])
        parts = rng.standard_normal((2, *amplitudes.shape))
        amplitudes = amplitudes + noise * (parts[0] + 1j * parts[1])
    return Residual(beam.model.output_names, nominal_swings(move, beam), np.sum(np.abs(amplitudes), axis=2))


def nominal_swings(move: Move, beam: KnownBeam) -> FloatArray:
    """Return the swing of the model as it stands at every output, shape (n_outputs,) [m]."""
    poles = beam.model.poles
    return np.asarray(np.abs(beam.model.residues) @ (np.abs(move.end_phasors(poles)) / poles.imag))


def insensitivity(move: Move, beam: KnownBeam, errors: FloatArray) -> FloatArray:
    """Return the swing of the worst output where all frequencies are off by shares, shape (n_errors,) [m].

    What is expected of friction, stiffening and drag counts, which a command may cancel; what scatters does not.

    Parameters
    ----------
    errors : ndarray, shape (n_errors,) -- relative error of the natural frequencies
    """
    poles = beam.model.poles[None, :] * (1.0 + np.asarray(errors))[:, None]
    phasors = move.end_phasors(poles) + expected_disturbance(move, beam)
    amplitudes = np.abs(phasors) / poles.imag
    return np.asarray(np.max(amplitudes @ np.abs(beam.model.residues).T, axis=1))


def expected_disturbance(move: Move, beam: KnownBeam) -> ComplexArray:
    """Return the mean of what friction, stiffening and drag add to the end phasors, shape (n_modes,) [m/s]."""
    return np.asarray(np.mean(_of_friction(move, beam) + _of_law(move, beam), axis=0))


def _of_friction(move: Move, beam: KnownBeam) -> ComplexArray:
    """Return the phasors of the hub's lag, which turns over with the direction, shape (n_draws, n_modes)."""
    lag, draws = beam.axis.lag, beam.draws
    total = np.zeros_like(draws.poles)
    if lag == 0.0:
        return total
    behind, step = lag * draws.lag_before, np.exp(draws.poles * move.period_s)
    for way in np.diff(move.positions).tolist():
        # The hub stays where it is until the command is a lag ahead of it.
        left = np.clip(behind - way, -lag, lag)
        total = (total + (left - behind)[:, None]) * step
        behind = left
    return np.asarray(total * draws.poles)


def scatter_phasors(beam: KnownBeam, duration_s: float) -> FloatArray:
    """Return the standard deviation of an end phasor's parts per scatter of the hub, shape (n_modes,) [1/s]."""
    poles = beam.model.poles
    # What was set going early in a long move has decayed.
    lasting = np.minimum(duration_s, -0.5 / np.minimum(poles.real, -1e-9))
    return np.asarray(0.5 * np.abs(poles) ** 1.5 * np.sqrt(lasting))


def _of_scatter(move: Move, beam: KnownBeam) -> ComplexArray:
    scatter = beam.axis.scatter_at(float(np.max(np.abs(move.accelerations))))
    return scatter * scatter_phasors(beam, move.duration_s) * beam.draws.scatter


def _of_law(move: Move, beam: KnownBeam) -> ComplexArray:
    law = beam.law
    if law is None:
        return np.zeros_like(beam.draws.poles)
    pole = beam.model.poles[law.mode]
    share = beam.model.residues[law.output, law.mode]
    step = np.exp(pole * move.period_s)
    weights = step ** (len(move.velocities) - 1 - np.arange(len(move.velocities))) * move.period_s / share
    drive = np.append(move.accelerations, 0.0)
    extra = np.zeros(len(drive))
    forces = (extra, extra)
    for _ in range(_ROUNDS):
        # q = -Im(z) / Im(p) with z' = p z + a, at the ticks; what the last round's forces are is one more drive.
        held = (step - 1.0) / pole * np.append(0.0, (drive + extra / share)[:-1])
        z = one_pole(step, held.astype(np.complex128))
        y, rates = -share * z.imag / pole.imag, -share * (pole * z).imag / pole.imag
        forces = law.forces(move.velocities, y, rates)
        extra = forces[0] + forces[1]
    phasors = np.zeros((2, beam.model.n_modes), dtype=complex)
    phasors[:, law.mode] = np.stack(forces) @ weights
    sizes = np.array([[law.stiffening, law.stiffening_sd], [law.drag, law.drag_sd]])
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(sizes[:, 0] != 0.0, sizes[:, 1] / np.abs(sizes[:, 0]), 0.0)
    return np.asarray((1.0 + beam.draws.law * relative) @ phasors)
