"""One experiment on four axes in virtual time: the models agree within their covariances, whatever moves the hub."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from beam_ident import (
    EstimatorSettings,
    InputSignal,
    ModalModel,
    OutputSignal,
    Prior,
    TimeRecord,
    compare_models,
    run_estimator,
)
from beam_ros.excitation.plan import plan_excitation
from beam_ros.hub.emulated.odrive import EmulatedOdrive
from beam_ros.hub.emulated.servo import servo_parameters
from beam_ros.hub.emulated.trajectory_controller import EmulatedTrajectoryController, Waypoints
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.links.odrive_protocol import decode_line, encode_line, numbers
from beam_ros.hub.links.trajectory import Knots
from beam_ros.hub.parameters import SimulatedDevice
from beam_ros.hub.simulated.beam_points import BeamPoints
from beam_ros.hub.simulated.motion import HubMotion
from beam_ros.hub.simulated.plant import beam_on_axis
from beam_ros.rig.rig import Rig

RIG = Rig.from_file().with_values(
    {"excitation.duration": 6.0, "excitation.still": 3.0, "excitation.end_frequency": 40.0}
)
FRAME_NS = 10_000_000
LEAD_NS = 500_000_000
NOISE = 5e-6


class _Filmed:
    """Displacements of the markers every 10 ms, and the hub's samples as the axis gave them."""

    def __init__(self, seed: int) -> None:
        self._points = BeamPoints(RIG.beam_model(), RIG.markers.heights)
        self._rng = np.random.default_rng(seed)
        self._frames: list[tuple[int, np.ndarray]] = []
        self._next_ns = FRAME_NS
        self.hub: list[tuple[float, float]] = []

    def film(self, reached_ns: int, snapshots) -> None:
        while self._next_ns <= reached_ns:
            u = self._points.displacements(snapshots([self._next_ns]))[0]
            self._frames.append((self._next_ns, u + NOISE * self._rng.standard_normal(len(u))))
            self._next_ns += FRAME_NS

    def model(self) -> ModalModel:
        times, values = (np.array(column) for column in zip(*self.hub, strict=True))
        drive = InputSignal("hub", "m", times * 1e-9, values, "cubic", 1e-7 / np.sqrt(12))
        stamps = np.array([stamp for stamp, _ in self._frames]) * 1e-9
        inside = (stamps > times[0] * 1e-9 + 0.05) & (stamps < times[-1] * 1e-9 - 0.05)
        table = np.array([u for _, u in self._frames])
        outputs = tuple(
            OutputSignal(name, "m", stamps[inside], table[inside, k])
            for k, name in enumerate(RIG.markers.names)
        )
        settings = EstimatorSettings("base_motion", 2, Prior(0.0, 1e-9))
        return run_estimator("modal", TimeRecord((drive,), outputs, 0, "run"), settings).model


def _plant(parameters):
    return beam_on_axis(RIG.beam_model(), parameters)


def _by_ticks(values: np.ndarray) -> ModalModel:
    """The suite's own protocol: the device holds each acceleration for its tick of 1 ms."""
    parameters = RIG.axis_parameters()
    filmed = _Filmed(1)
    motion = HubMotion(parameters, _plant(parameters), SimulatedDevice())
    for value in np.concatenate((np.zeros(500), values)):
        filmed.hub.append((motion.device_ns, motion.position_count * 1e-7))
        motion.follow(value)
        filmed.film(motion.device_ns, motion.snapshots)
    return filmed.model()


def _by_trajectory(values: np.ndarray, rate: float) -> ModalModel:
    """A JointTrajectoryController at a rate, whose joint states are the input."""
    parameters = RIG.axis_parameters()
    plan = MotionPlan.sequence(values, parameters, 0.0)
    knots = Knots.of(plan, LEAD_NS, 0.0, 0.02)
    controller = EmulatedTrajectoryController(
        parameters, _plant(servo_parameters(parameters)), 0, metres_per_unit=0.02
    )
    controller.receive(Waypoints(knots.start_ns, knots.times_ns, knots.positions, knots.velocities), 1)
    filmed = _Filmed(2)
    for now_ns in range(0, LEAD_NS + round(plan.duration * 1e9), round(1e9 / rate)):
        position, _ = controller.update(now_ns)
        filmed.hub.append((now_ns, position * 0.02))
        filmed.film(controller.reached_ns, controller.snapshots)
    return filmed.model()


def _by_odrive(values: np.ndarray) -> ModalModel:
    """An ODrive, 200 uneven questions a second, each stamped to within 0.1 ms."""
    parameters = RIG.axis_parameters()
    plan = MotionPlan.sequence(values, parameters, 0.0)
    odrive = EmulatedOdrive(
        parameters, _plant(servo_parameters(parameters)), SimulatedDevice(), metres_per_turn=0.02
    )
    odrive.exchange(b"w axis0.controller.config.vel_limit 25\nw axis0.requested_state 8\n", 0)
    rng = np.random.default_rng(3)
    filmed = _Filmed(3)
    for k in range(1, round((LEAD_NS * 1e-9 + plan.duration) * 200)):
        now_ns = k * 5_000_000 + int(rng.integers(0, 1_500_000))
        position, velocity, _ = plan.at((now_ns - LEAD_NS) * 1e-9)
        command = encode_line(f"p 0 {position / 0.02:.9f} {velocity / 0.02:.6f}")
        answer = odrive.exchange(command + encode_line("f 0"), now_ns)
        turns, _ = numbers(decode_line(answer), 2)
        filmed.hub.append((now_ns + float(rng.uniform(-1e5, 1e5)), turns * 0.02))
        filmed.film(odrive.axis.device_ns - 1_000_000, odrive.axis.snapshots)
    return filmed.model()


@pytest.fixture(scope="module")
def values() -> np.ndarray:
    return plan_excitation(RIG).values


@pytest.fixture(scope="module")
def reference(values) -> ModalModel:
    return _by_ticks(values)


@pytest.mark.parametrize("axis", ["trajectory 250 Hz", "odrive"])
def test_the_same_experiment_gives_the_same_model(axis: str, values, reference) -> None:
    kind, _, rate = axis.partition(" ")
    model = _by_odrive(values) if kind == "odrive" else _by_trajectory(values, float(rate.split()[0]))
    comparison = compare_models(reference, model)
    assert comparison.degrees_of_freedom >= 4
    assert comparison.chi_squared < chi2.ppf(0.999, comparison.degrees_of_freedom)
    truth = RIG.beam_model().natural_frequencies[:2]
    np.testing.assert_allclose(model.natural_frequencies, truth, rtol=1e-3)
