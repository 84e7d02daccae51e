"""What the rig's model predicts of the beam while the hub moves: the dashed line of the page.

A mode of the clamped beam obeys q'' + 2 zeta omega q' + omega^2 q = -Gamma alpha''. The hub's acceleration is not
measured, and its second difference is noise. With p = q + Gamma alpha it is not needed:

    p'' + 2 zeta omega p' + omega^2 p = Gamma (2 zeta omega alpha' + omega^2 alpha)

Between two samples the hub's position is taken as a straight line. For that the step is exact, at any period. Where
batches were lost, it is the cubic that goes on with the speeds on both sides: a straight line would strike the beam
at both ends, and the beam rings on for many seconds.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import expm

from beam_model import BeamModel
from beam_ros.arrays import FloatArray


class PredictedMotion:
    """Modal coordinates of a beam whose hub was seen to move.

    Parameters
    ----------
    model : BeamModel
    forgotten_after_s : float -- after a longer gap of the hub's samples the beam is taken to be at rest [s]

    Attributes
    ----------
    n_modes : int
    """

    def __init__(self, model: BeamModel, *, forgotten_after_s: float = 0.5) -> None:
        omega, zeta = model.natural_frequencies, model.damping_ratios
        self.n_modes = n = len(omega)
        self._participation = model.participation_factors
        self._forgotten_after_s = forgotten_after_s
        # The state is p, p', alpha, alpha'.
        system = np.zeros((2 * n + 2, 2 * n + 2))
        system[:n, n : 2 * n] = np.eye(n)
        system[n : 2 * n, :n] = -np.diag(omega**2)
        system[n : 2 * n, n : 2 * n] = -np.diag(2.0 * zeta * omega)
        system[n : 2 * n, -2] = self._participation * omega**2
        system[n : 2 * n, -1] = self._participation * 2.0 * zeta * omega
        system[-2, -1] = 1.0
        self._system = system
        self._transition = lru_cache(maxsize=8)(self._transition_of)
        self._state: FloatArray | None = None
        self._stamp_ns = 0

    def _transition_of(self, step_ns: int) -> FloatArray:
        return np.asarray(expm(self._system * (step_ns * 1e-9)))

    def add(self, stamps_ns: list[int], positions: FloatArray) -> FloatArray:
        """Follow the hub through some samples.

        Parameters
        ----------
        stamps_ns : list of int, length n_samples -- [ns]
        positions : ndarray, shape (n_samples,) -- of the hub [m]

        Returns
        -------
        ndarray, shape (n_samples, n_modes) -- q at these samples, in units of the mode shapes
        """
        bridge_ns, bridge = self._bridge(stamps_ns, positions)
        found = np.zeros((len(bridge) + len(positions), self.n_modes))
        samples = zip([*bridge_ns, *stamps_ns], [*bridge, *positions.tolist()], strict=True)
        for k, (stamp_ns, position) in enumerate(samples):
            step_ns = stamp_ns - self._stamp_ns
            self._stamp_ns = stamp_ns
            state = self._state
            if state is None or not 0 < step_ns <= self._forgotten_after_s * 1e9:
                state = np.zeros(len(self._system))
                state[: self.n_modes] = self._participation * position
            else:
                state[-1] = (position - state[-2]) / (step_ns * 1e-9)
                # To the microsecond: jitter of the stamps below it would only fill the cache.
                state = self._transition(round(step_ns, -3)) @ state
            state[-2] = position
            self._state = state
            found[k] = state[: self.n_modes] - self._participation * position
        return found[len(bridge) :]

    def _bridge(self, stamps_ns: list[int], positions: FloatArray) -> tuple[list[int], list[float]]:
        """Return samples, as far apart as those to come, that join them to the last one where some are missing."""
        gap_ns = stamps_ns[0] - self._stamp_ns
        if self._state is None or len(stamps_ns) < 2 or not 0 < gap_ns <= self._forgotten_after_s * 1e9:
            return [], []
        step_ns = stamps_ns[1] - stamps_ns[0]
        between = np.arange(step_ns, gap_ns - step_ns // 2, step_ns)
        speeds = (self._state[-1], (positions[1] - positions[0]) / (step_ns * 1e-9))
        cubic = CubicHermiteSpline([0.0, gap_ns * 1e-9], [self._state[-2], positions[0]], speeds)
        return (self._stamp_ns + between).tolist(), cubic(between * 1e-9).tolist()
