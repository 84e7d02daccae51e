"""A force on a hub that rolls with friction: its pole beside one integrator, and the beam's modes."""

from __future__ import annotations

import time
from functools import cached_property

import numpy as np

from beam_ident import InputSignal, LogChirp, TimeRecord, TransferFunctionModel, estimate_common_poles
from beam_ident.arrays import FloatArray
from benchmarks.ident.forced_hub import PERIOD_S, ForcedHub
from benchmarks.ident.study import AgainstBound, Outcome, Study, stated_bound


class FrictionCase(AgainstBound):
    """Two free-hub modes and the rate at which friction stops the hub, from three points.

    Parameters
    ----------
    viscous_friction : float -- [N s/m]
    chirp : LogChirp -- of the force, per total mass
    """

    def __init__(self, viscous_friction: float = 0.4, chirp: LogChirp | None = None) -> None:
        self.hub = ForcedHub(viscous_friction=viscous_friction)
        mass = float(self.hub.model.matrices.M[0, 0])
        self.forces = mass * (chirp or LogChirp(end_frequency=45.0)).sample(PERIOD_S).accelerations
        _, self.stamps, self.clean = self.hub.film(self.forces)
        A, scale = self.hub.A, self.hub.scale
        poles = np.linalg.eigvals(A * scale[:, None] / scale)
        poles = poles[np.argsort(np.abs(poles))]  # the hub's position, its friction, and pairs
        modes = poles[poles.imag > 0.0][:2]
        self.truth = np.concatenate([np.abs(modes), -modes.real / np.abs(modes), [-poles[1].real]])

    @cached_property
    def bound(self) -> FloatArray:
        """Standard deviations stated for a record of the middle."""
        return stated_bound(lambda seed: self.flat(self.estimate(seed))[1])

    def record(self, seed: int) -> TimeRecord:
        """Return the force and the camera's record of one seed."""
        drive = InputSignal("force", "N", (0.0, PERIOD_S), self.forces, "zoh")
        return TimeRecord((drive,), self.hub.outputs(seed, self.stamps, self.clean))

    def estimate(self, seed: int) -> TransferFunctionModel:
        """Estimate from one record; the sixth zero makes room for the static term of the upper modes."""
        return estimate_common_poles(self.record(seed), 5, 6, n_integrators=1).models[0]

    @staticmethod
    def flat(model: TransferFunctionModel) -> tuple[FloatArray, FloatArray]:
        """Return frequencies [rad/s], damping ratios and the friction's rate [rad/s], and their deviations."""
        omega, zeta, omega_sd, zeta_sd = model.modes()
        poles, pole_sd = model.real_poles()
        return np.concatenate([omega, zeta, -poles]), np.concatenate([omega_sd, zeta_sd, pole_sd])

    def run(self, seed: int) -> Outcome:
        """Estimate from one record; another number of modes is a failure."""
        start = time.perf_counter()
        estimate, sd = self.flat(self.estimate(seed))
        seconds = time.perf_counter() - start
        return Outcome(seconds, estimate, sd) if len(estimate) == len(self.truth) else Outcome(seconds)


STUDIES = {"free-hub-friction": Study("rig on a hub with friction under a known force", 300, FrictionCase)}
