"""One experiment on every axis in virtual time: the models agree within their covariances, whatever moves the hub."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial

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
from beam_ros.hub.contract import HubReport
from beam_ros.hub.emulated.controller import Firmware
from beam_ros.hub.emulated.dynamixel import EmulatedDynamixel
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.emulated.odrive import EmulatedOdrive
from beam_ros.hub.emulated.servo import ServoAxis, servo_parameters
from beam_ros.hub.emulated.trajectory_controller import EmulatedTrajectoryController, Waypoints
from beam_ros.hub.links import dynamixel_protocol as table
from beam_ros.hub.links.motion_plan import MotionPlan
from beam_ros.hub.links.odrive_protocol import decode_line, encode_line, numbers
from beam_ros.hub.links.trajectory import Knots
from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
from beam_ros.hub.simulated.beam_points import BeamPoints
from beam_ros.hub.simulated.motion import HubMotion
from beam_ros.hub.simulated.plant import Plant, beam_on_axis
from beam_ros.rig.rig import Rig
from benchmarks.paced_firmware import PacedFirmware
from tests.beam_ros.hub.hub_scenes import STEADY_START, UNIX_START, LoopbackRig, chunks_of
from tests.firmware.builds import built

RIG = Rig.from_file().with_values(
    {"excitation.duration": 6.0, "excitation.still": 3.0, "excitation.end_frequency": 40.0}
)
RIGS = {
    "acceleration": RIG,
    "effort": RIG.with_values({"hub.command_mode": "effort", "excitation.acceleration": 0.2}),
}
FRAME_NS = 10_000_000
LEAD_NS = 500_000_000
NOISE = 5e-6


class _Filmed:
    """Displacements of the markers every 10 ms, and the hub's samples as the axis gave them."""

    def __init__(
        self, seed: int, mode: str = "acceleration", begun_ns: int = 0, resolution: float = 1e-7
    ) -> None:
        self._points = BeamPoints(RIG.beam_model(), RIG.markers.heights)
        self._rng = np.random.default_rng(seed)
        self._frames: list[tuple[int, np.ndarray]] = []
        self._next_ns = begun_ns + FRAME_NS
        self._is_forced = mode == "effort"
        self._resolution = resolution
        self.hub: list[tuple[float, float]] = []
        """Times [ns], and forces that are held [N] or positions [m]."""

    def film(self, reached_ns: int, snapshots) -> None:
        while self._next_ns <= reached_ns:
            u = self._points.displacements(snapshots([self._next_ns]))[0]
            self._frames.append((self._next_ns, u + NOISE * self._rng.standard_normal(len(u))))
            self._next_ns += FRAME_NS

    def model(self) -> ModalModel:
        times, values = (np.array(column) for column in zip(*self.hub, strict=True))
        if self._is_forced:
            drive = InputSignal("hub", "N", times * 1e-9, values, "zoh", 0.0)
        else:
            drive = InputSignal("hub", "m", times * 1e-9, values, "cubic", self._resolution / np.sqrt(12))
        stamps = np.array([stamp for stamp, _ in self._frames]) * 1e-9
        inside = (stamps > times[0] * 1e-9 + 0.05) & (stamps < times[-1] * 1e-9 - 0.05)
        table = np.array([u for _, u in self._frames])
        outputs = tuple(
            OutputSignal(name, "m", stamps[inside], table[inside, k])
            for k, name in enumerate(RIG.markers.names)
        )
        structure = "force" if self._is_forced else "base_motion"
        settings = EstimatorSettings(structure, 2, Prior(0.0, 1e-9))
        return run_estimator("modal", TimeRecord((drive,), outputs, 0, "run"), settings).model


def _plant(parameters):
    return beam_on_axis(RIG.beam_model(), parameters)


def _by_ticks(values: np.ndarray, mode: str) -> ModalModel:
    """The simulator: it holds each acceleration or force for its tick of 1 ms."""
    parameters = RIGS[mode].axis_parameters()
    filmed = _Filmed(1, mode)
    motion = HubMotion(parameters, _plant(parameters), SimulatedDevice())
    for value in np.concatenate((np.zeros(500), values)):
        filmed.hub.append((motion.device_ns, value if mode == "effort" else motion.position_count * 1e-7))
        motion.follow(value)
        filmed.film(motion.device_ns, motion.snapshots)
    return filmed.model()


class _OnLine(LoopbackRig):
    """The driver's client and a device that speaks the suite's own protocol, which carries the beam."""

    def __init__(self, mode: str, boot: Callable[[AxisParameters, Plant], Firmware]) -> None:
        parameters = RIGS[mode].axis_parameters()
        self._boot = boot
        # Paced, the clock of an emulated processor stands still between ticks: 0.1 ms of what it says is chance.
        link = LinkParameters(max_clock_sd_ns=200_000)
        super().__init__(parameters, device=SimulatedDevice(), link=link)

    def start_device(self, _boot_id: int) -> None:
        self.firmware = self._boot(self.parameters, _plant(self.parameters))
        self.boot_ns = self.steady_ns

    def ticks(self, report: HubReport, mode: str) -> Iterator[tuple[int, float]]:
        """Device time and input of every sample: what was applied to a free hub, or where a led one was measured."""
        batches = report.applied if mode == "effort" else report.measured
        for batch in batches:
            # The stamps know the tick; when it was, the device's own count says exactly.
            since_boot_ns = batch.stamp_ns - UNIX_START - (self.boot_ns - STEADY_START)
            first = round(since_boot_ns / batch.period_ns)
            values = batch.efforts if mode == "effort" else batch.positions
            yield from (((first + k) * batch.period_ns, value) for k, value in enumerate(values))


def _by_line(values: np.ndarray, mode: str, seed: int, boot: Callable[..., Firmware]) -> ModalModel:
    """A device of the suite's own protocol: connected, homed, enabled, and given the sequence, by the real client."""
    rig = _OnLine(mode, boot)
    try:
        rig.until(lambda report: bool(report.measured))
        rig.enable()
        for chunk in chunks_of(values, rig.now.unix_ns + LEAD_NS):
            rig.hub.load(chunk, rig.now)
        axis = rig.firmware.axis
        filmed = _Filmed(seed, mode, axis.device_ns - axis.device_ns % FRAME_NS)
        states = []
        while "done" not in states[-1:]:
            (report,) = rig.run(0.01)
            states += [sequence.state for sequence in report.sequences]
            assert not {"refused", "aborted", "underrun"} & set(states), report
            filmed.hub += rig.ticks(report, mode)
            filmed.film(axis.device_ns, axis.snapshots)
    finally:
        if isinstance(rig.firmware, PacedFirmware):
            rig.firmware.close()
    assert {round(step) for step in np.diff([time for time, _ in filmed.hub])} == {1_000_000}
    return filmed.model()


def _emulator(parameters: AxisParameters, plant: Plant) -> EmulatedFirmware:
    return EmulatedFirmware(parameters, plant, SimulatedDevice(), boot_id=1)


def _processor(parameters: AxisParameters, plant: Plant) -> PacedFirmware:
    return PacedFirmware(built("stm32f405-plant.elf"), parameters, plant)


def _servo(parameters: AxisParameters) -> ServoAxis:
    return ServoAxis(parameters, _plant(servo_parameters(parameters)), SimulatedDevice())


def _by_trajectory(values: np.ndarray, rate: float) -> ModalModel:
    """A JointTrajectoryController at a rate, whose joint states are the input."""
    parameters = RIG.axis_parameters()
    plan = MotionPlan.sequence(values, parameters, 0.0)
    knots = Knots.of(plan, LEAD_NS, 0.0, 0.02)
    controller = EmulatedTrajectoryController(_servo(parameters), metres_per_unit=0.02)
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
    odrive = EmulatedOdrive(_servo(parameters), metres_per_turn=0.02, closing_s=0.0)
    odrive.exchange(b"w axis0.controller.config.vel_limit 25\nw axis0.requested_state 8\n", 0)
    rng = np.random.default_rng(3)
    filmed = _Filmed(3)
    for k in range(1, round((LEAD_NS * 1e-9 + plan.duration) * 200)):
        now_ns = k * 5_000_000 + int(rng.integers(0, 1_500_000))
        position, velocity, _ = plan.at((now_ns - LEAD_NS) * 1e-9)
        command = encode_line(f"p 0 {position / 0.02:.9f} {velocity / 0.02:.6f}")
        answer = odrive.exchange(command + encode_line("f 0"), now_ns)
        turns, _ = numbers(decode_line(answer), 2, "f 0")
        filmed.hub.append((now_ns + float(rng.uniform(-1e5, 1e5)), turns * 0.02))
        filmed.film(odrive.axis.device_ns - 1_000_000, odrive.axis.snapshots)
    return filmed.model()


def _by_dynamixel(values: np.ndarray) -> ModalModel:
    """A servo with 4096 counts in 32 mm, 200 uneven questions a second, each stamped to within 0.1 ms."""
    per_turn = 0.032
    parameters = RIG.axis_parameters()
    plan = MotionPlan.sequence(values, parameters, 0.0)
    servo = EmulatedDynamixel(_servo(parameters), metres_per_turn=per_turn, values={11: 4, 9: 0})
    servo.exchange(table.encode_sync_write(1, table.TORQUE_ENABLE, 1), 0)
    rng = np.random.default_rng(4)
    filmed = _Filmed(6, resolution=per_turn / table.COUNTS)
    for k in range(1, round((LEAD_NS * 1e-9 + plan.duration) * 200)):
        now_ns = k * 5_000_000 + int(rng.integers(0, 1_500_000))
        position, _, _ = plan.at((now_ns - LEAD_NS) * 1e-9)
        goal = table.encode_sync_write(1, table.GOAL_POSITION, round(position / per_turn * table.COUNTS))
        question = table.encode_read(1, table.VELOCITY_AND_POSITION)
        taken = table.take_status(servo.exchange(goal + question, now_ns))
        counts = int.from_bytes(table.decode(taken[0]).parameters[4:], "little", signed=True)
        filmed.hub.append((now_ns + float(rng.uniform(-1e5, 1e5)), counts / table.COUNTS * per_turn))
        filmed.film(servo.axis.device_ns - 1_000_000, servo.axis.snapshots)
    return filmed.model()


@cache
def _values(mode: str) -> np.ndarray:
    return plan_excitation(RIGS[mode]).values


@cache
def _reference(mode: str) -> ModalModel:
    return _by_ticks(_values(mode), mode)


def _check_same(model: ModalModel, mode: str) -> None:
    """Hold a model against the simulator's, whose noise is another, and against the beam that both were made from."""
    comparison = compare_models(_reference(mode), model)
    assert comparison.degrees_of_freedom >= 4
    assert comparison.chi_squared < chi2.ppf(0.999, comparison.degrees_of_freedom)
    beam = RIG.beam_model()
    truth = beam.free_hub_natural_frequencies if mode == "effort" else beam.natural_frequencies
    np.testing.assert_allclose(model.natural_frequencies, truth[:2], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["trajectory 250 Hz", "odrive", "dynamixel"])
def test_the_same_experiment_gives_the_same_model(axis: str) -> None:
    by = {"odrive": _by_odrive, "dynamixel": _by_dynamixel}.get(axis, partial(_by_trajectory, rate=250.0))
    _check_same(by(_values("acceleration")), "acceleration")


@pytest.mark.slow
@pytest.mark.parametrize("mode", RIGS)
def test_the_same_experiment_through_the_emulator_gives_the_same_model(mode: str) -> None:
    _check_same(_by_line(_values(mode), mode, 4, _emulator), mode)


@pytest.mark.verify
@pytest.mark.parametrize("mode", RIGS)
def test_the_same_experiment_through_the_processor_gives_the_same_model(mode: str) -> None:
    """The firmware for the STM32F405, instruction by instruction in QEMU."""
    _check_same(_by_line(_values(mode), mode, 5, _processor), mode)
