"""The rig with a hub of finite mass under a force: a soft servo's, or the experimenter's.

A soft servo moves with the beam that pulls on it.  Its measured position as the input still gives
the clamped beam; the force on a free hub gives the free hub's modes beside a rigid body.
"""

from __future__ import annotations

import time
from functools import cached_property

import numpy as np

from beam_ident import InputSignal, LogChirp, ModalModel, OutputSignal, TimeRecord, identify
from beam_ident.arrays import FloatArray
from beam_model import AxisStepper, BeamModel, BeamParameters, Damping, PositionServo
from beam_model.galerkin.stepping import ForceStepper, discretise
from benchmarks.ident.rig import flat
from benchmarks.ident.study import AgainstBound, Outcome, Study, stated_bound

PERIOD_S, FRAME_S, EXPOSURE_S = 1e-3, 10e-3, 5e-3
HEIGHTS = np.array([0.010, 0.225, 0.285])
NAMES = ("z010", "z225", "z285")
CAMERA_SD, ENCODER_QUANTUM = 5e-6, 1e-7
# Two Gauss points in every half tick integrate a mode of 250 Hz to 1e-4 of its amplitude.
_NODES = 0.25 * PERIOD_S * (1.0 + np.array([-1.0, 1.0]) / np.sqrt(3.0))


class ForcedHub:
    """Hub and beam under forces held over every tick, filmed at a hundred frames a second.

    Parameters
    ----------
    hub_mass : float -- [kg]
    viscous_friction : float -- of the hub on its rail [N s/m]
    """

    def __init__(self, hub_mass: float = 0.8, viscous_friction: float = 0.0) -> None:
        parameters = BeamParameters.from_section(
            0.30,
            0.025,
            0.0005,
            7850.0,
            200e9,
            hub_mass=hub_mass,
            gravity="upright",
            damping=Damping(ratios=(0.005,)),
        )
        self.model = BeamModel(parameters, n_modes=14)
        self.A, self.B = self.model.matrices.state_space()
        self.A[:, self.model.n_modes + 1] -= viscous_friction * self.B
        lowest = self.model.natural_frequencies[0]
        self.scale = np.concatenate(
            [[lowest], self.model.natural_frequencies, np.ones(self.model.n_modes + 1)]
        )

    def film(self, forces: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return hub positions at the ticks, stamps, and displacements averaged over exposures, (n, 3)."""
        model = self.model
        A, B, scale = self.A, self.B, self.scale
        states = ForceStepper(A, B, PERIOD_S, scale).run(forces)
        n = model.n_modes
        row = np.concatenate([np.ones((3, 1)), model.shape(HEIGHTS), np.zeros((3, n + 1))], axis=1)
        row = row - model.residual_terms(HEIGHTS)[:, None] * A[n + 1]
        direct = -model.residual_terms(HEIGHTS) * B[n + 1]
        halves = np.zeros((2 * len(forces), 3))
        for half in range(2):
            for node in _NODES:
                step, held, _ = discretise(A, B, node + 0.5 * half * PERIOD_S, scale)
                inside = states[:-1] @ (row @ step).T + np.outer(forces, row @ held + direct)
                halves[half::2] += 0.5 * inside
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(halves, axis=0)])
        per_frame, width = round(FRAME_S / PERIOD_S), round(EXPOSURE_S / PERIOD_S)
        centres = np.arange(per_frame, len(forces) - per_frame, per_frame)
        averaged = (total[2 * centres + width] - total[2 * centres - width]) / (2 * width)
        return states[:, 0], centres * PERIOD_S, averaged

    def outputs(
        self, seed: int, stamps: FloatArray, clean: FloatArray, quiet: float = 1.0
    ) -> tuple[OutputSignal, ...]:
        """Return what a camera with noise of 5 um says."""
        values = clean + quiet * CAMERA_SD * np.random.default_rng(seed).standard_normal(clean.shape)
        return tuple(
            OutputSignal(name, "m", stamps, values[:, j], EXPOSURE_S) for j, name in enumerate(NAMES)
        )


class SoftServoCase(AgainstBound):
    """Clamped modes from the measured position of a hub behind a servo of finite bandwidth.

    Parameters
    ----------
    bandwidth_hz : float -- natural frequency of the loop on the hub's mass, damped by 0.7
    n_modes : int -- that the servo still excites
    chirp : LogChirp
    """

    def __init__(self, bandwidth_hz: float = 30.0, n_modes: int = 3, chirp: LogChirp | None = None) -> None:
        hub = ForcedHub()
        self.hub, self.n_modes = hub, n_modes
        excitation = (chirp or LogChirp()).sample(PERIOD_S)
        omega, mass = 2.0 * np.pi * bandwidth_hz, hub.model.parameters.hub_mass
        servo = PositionServo(proportional=mass * omega**2, derivative=1.4 * mass * omega)
        axis = AxisStepper(hub.model, PERIOD_S, servo=servo)
        forces = np.array(
            [
                axis.step_servo(position, velocity)
                for position, velocity in zip(
                    excitation.positions[:-1].tolist(), excitation.velocities[:-1].tolist(), strict=True
                )
            ]
        )
        self.positions, self.stamps, self.clean = hub.film(forces)
        self.set_points = excitation.positions
        self.truth = np.concatenate(
            [
                hub.model.natural_frequencies[:n_modes],
                hub.model.damping_ratios[:n_modes],
                hub.model.motion_residues(HEIGHTS)[:, :n_modes].ravel(),
            ]
        )

    @cached_property
    def bound(self) -> FloatArray:
        """Return the standard deviations that records state."""
        return stated_bound(lambda seed: flat(identify(self.record(seed), n_modes=self.n_modes).model)[1])

    def record(self, seed: int) -> TimeRecord:
        """Return the measured position and the camera's record of one seed."""
        zero = ENCODER_QUANTUM * np.random.default_rng([seed, 1]).uniform(-0.5, 0.5)
        seen = ENCODER_QUANTUM * np.round((self.positions - zero) / ENCODER_QUANTUM) + zero
        drive = InputSignal("hub", "m", (0.0, PERIOD_S), seen, "cubic", ENCODER_QUANTUM / np.sqrt(12.0))
        return TimeRecord((drive,), self.hub.outputs(seed, self.stamps, self.clean))

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes is a failure."""
        record = self.record(seed)
        start = time.perf_counter()
        model = identify(record).model
        seconds = time.perf_counter() - start
        return Outcome(seconds, *flat(model)) if model.n_modes == self.n_modes else Outcome(seconds)


class FreeHubCase(AgainstBound):
    """Free-hub modes and the rigid body from the force on the hub.

    Parameters
    ----------
    chirp : LogChirp -- of the force, per total mass
    """

    def __init__(self, chirp: LogChirp | None = None) -> None:
        hub = ForcedHub()
        self.hub = hub
        mass = float(hub.model.matrices.M[0, 0])
        self.forces = mass * (chirp or LogChirp()).sample(PERIOD_S).accelerations
        _, self.stamps, self.clean = hub.film(self.forces)
        self.truth = np.concatenate(
            [
                hub.model.free_hub_natural_frequencies[:3],
                hub.model.free_hub_damping_ratios[:3],
                np.full(3, 1.0 / mass),
            ]
        )

    @cached_property
    def bound(self) -> FloatArray:
        """Return the standard deviations that records state."""
        return stated_bound(lambda seed: self.flat(identify(self.record(seed), "force", n_modes=3).model)[1])

    @staticmethod
    def flat(model: ModalModel) -> tuple[FloatArray, FloatArray]:
        """Return frequencies, damping ratios and gains, and their standard deviations."""
        parts = (model.natural_frequencies, model.damping_ratios, model.gains)
        sds = (model.natural_frequency_sd, model.damping_ratio_sd, model.gain_sd)
        return np.concatenate(parts), np.concatenate(sds)

    def record(self, seed: int) -> TimeRecord:
        """Return the force and the camera's record of one seed."""
        drive = InputSignal("force", "N", (0.0, PERIOD_S), self.forces, "zoh")
        return TimeRecord((drive,), self.hub.outputs(seed, self.stamps, self.clean))

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes is a failure."""
        record = self.record(seed)
        start = time.perf_counter()
        model = identify(record, "force").model
        seconds = time.perf_counter() - start
        return Outcome(seconds, *self.flat(model)) if model.n_modes == 3 else Outcome(seconds)


STUDIES = {
    "soft-servo": Study("rig behind a servo of 30 Hz, measured position as input", 400, SoftServoCase),
    "free-hub": Study("rig on a free hub under a known force", 400, FreeHubCase),
}
