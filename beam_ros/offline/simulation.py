"""The experiment without ROS: the simulator's core straight into a bag, as fast as the computer can.

The same virtual axis, the same plant and the same camera as in the simulator node, led by a made-up clock,
so that a seed gives the same bag to the last byte of every message.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from beam_ros import messages
from beam_ros.arrays import ByteArray
from beam_ros.bags.apparatus import SIMULATED_SEQUENCE
from beam_ros.bags.batches import encode_batch
from beam_ros.bags.writing import BagWriter
from beam_ros.errors import RigUnavailableError
from beam_ros.excitation.plan import plan_excitation
from beam_ros.hub.contract import HostTime, HubReport, RequestKind
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.simulated_hub import SimulatedHub
from beam_ros.messages import BagTypes
from beam_ros.rig.filming import Exposure, Film
from beam_ros.rig.rig import Rig

Measure = Callable[[Exposure], Iterator[tuple[str, Any]]]
"""From an exposure to the topics and messages that tell of it."""

MeasureOfFilm = Callable[[Rig, Film, BagTypes], Measure]

START_NS = 1_700_000_000_000_000_000
"""Made-up real time at which every simulated experiment begins [ns, UNIX]."""

_STEP_NS = 10_000_000
_LEAD_NS = 500_000_000
_PATIENCE_S = 60.0


def simulate(
    rig: Rig,
    path: Path,
    *,
    with_camera: bool = False,
    measure: MeasureOfFilm | None = None,
    strip_points: int = 0,
    unevenness_s: float = 0.0,
    on_progress: Callable[[float, float], None] = lambda done_s, total_s: None,
) -> int:
    """Run the rig's excitation on the simulated rig and write the bag.

    Parameters
    ----------
    rig : Rig
    path : Path -- the bag's folder; must not exist
    with_camera : bool -- render every frame and track it, for beam/markers too, and keep the frames where
        ``recorder.images`` wants them; else displacements carry white noise
    measure : callable, optional -- made from rig, film and message types, and given every exposure: what it yields is
        written in the place of displacements
    strip_points, unevenness_s -- as of ``Film``
    on_progress : callable -- called with simulated seconds so far and in all

    Returns
    -------
    int -- messages written

    Raises
    ------
    UsageError
        The excitation leaves a limit.
    BagExistsError
        Something is at the path.
    CalibrationError
        The calibration that the rig names cannot be read, or is another camera's.
    """
    plan = plan_excitation(rig)
    model = rig.beam_model()
    parameters = rig.axis_parameters()
    drift_ppm = rig.simulation.hub_clock_ppm
    axis = VirtualAxis(parameters, rig.simulated_plant(model, drift_ppm), rig.simulated_device(drift_ppm))
    hub = SimulatedHub(axis, guard=rig.beam_guard())
    types = BagTypes()
    with BagWriter(path) as bag:
        run = _Run(hub, bag, types)
        run.step()
        film = Film(
            rig, model, hub.snapshots, hub.reached_ns, strip_points=strip_points, unevenness_s=unevenness_s
        )
        seen = (measure or (_tracked if with_camera else _noisy))(rig, film, types)

        def record_displacements() -> None:
            for exposure in film.due(hub.reached_ns):
                for topic, message in seen(exposure):
                    bag.write_message(topic, run.now_ns, message)

        run.after_step = record_displacements
        run.ask("home")
        run.ask("enable")
        start_ns = run.now_ns + _LEAD_NS
        period_ns = parameters.period_ns
        info = {**plan.info(rig), "sequence_id": SIMULATED_SEQUENCE, "start_ns": start_ns}
        bag.write_message("excitation/info", run.now_ns, messages.json_text(types, info))
        for chunk in messages.split_sequence(SIMULATED_SEQUENCE, start_ns, period_ns, plan.values):
            hub.load(chunk, run.now)
        total_s = (_LEAD_NS + len(plan.values) * period_ns) * 1e-9
        begun_ns = run.now_ns
        while run.sequence_state not in ("done", "refused", "aborted", "underrun"):
            run.step()
            on_progress((run.now_ns - begun_ns) * 1e-9, total_s)
        if run.sequence_state != "done":
            raise RigUnavailableError(
                f"the simulated hub ended the sequence as {run.sequence_state}: {run.sequence_reason}; change the "
                "excitation or the hub's limits"
            )
        hub.close()
        return bag.message_count


class _Run:
    """Made-up time, the hub's answers, and what of them is recorded."""

    def __init__(self, hub: SimulatedHub, bag: BagWriter, types: BagTypes) -> None:
        self._hub, self._bag, self._types = hub, bag, types
        self._elapsed_ns = 0
        self._completed: dict[int, str] = {}
        self.sequence_state = ""
        self.sequence_reason = ""
        self.after_step: Callable[[], None] = lambda: None

    @property
    def now_ns(self) -> int:
        return START_NS + self._elapsed_ns

    @property
    def now(self) -> HostTime:
        return HostTime(self._elapsed_ns, self.now_ns)

    def step(self) -> None:
        self._elapsed_ns += _STEP_NS
        self._record(self._hub.poll(self.now))
        self.after_step()

    def ask(self, kind: RequestKind) -> None:
        number = self._hub.request(kind)
        end_ns = self._elapsed_ns + round(_PATIENCE_S * 1e9)
        while number not in self._completed:
            if self._elapsed_ns > end_ns:
                raise RigUnavailableError(f"the simulated hub did not {kind} within {_PATIENCE_S:g} s")
            self.step()
        if self._completed[number]:
            raise RigUnavailableError(f"the simulated hub did not {kind}: {self._completed[number]}")

    def _record(self, report: HubReport) -> None:
        bag, types, now_ns = self._bag, self._types, self.now_ns
        for topic, batches in (("hub/applied", report.applied), ("hub/measured", report.measured)):
            for batch in batches:
                bag.write(topic, now_ns, encode_batch(batch))
        for sync in report.clock:
            bag.write_message("hub/clock_sync", now_ns, messages.clock_sync(types, sync))
        for sequence in report.sequences:
            self.sequence_state, self.sequence_reason = sequence.state, sequence.reason
            if sequence.state != "loading":
                bag.write_message("hub/sequence_state", now_ns, messages.sequence_state(types, sequence))
        for number, outcome in report.completed:
            self._completed[number] = "" if outcome.success else outcome.message


def _noisy(rig: Rig, film: Film, types: BagTypes) -> Measure:
    rng = np.random.default_rng(rig.simulation.seed)
    noise = rig.simulation.displacement_noise
    names = rig.markers.names

    def measure(exposure: Exposure) -> Iterator[tuple[str, Any]]:
        u = film.mean_displacement(exposure)
        u = u + noise * rng.standard_normal(len(u))
        for _, message in messages.displacement_messages(types, names, film.marker_stamps(exposure), u):
            yield "beam/displacement", message

    return measure


def image_messages(types: BagTypes, stamp_ns: int, frame: ByteArray) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of what a camera publishes with a frame: the image, and its size."""
    height, width = frame.shape
    yield "camera/image_raw", messages.image(types, stamp_ns, frame)
    yield "camera/camera_info", messages.camera_info(types, stamp_ns, width, height)


def rendered(rig: Rig, film: Film) -> Callable[[Exposure], ByteArray]:
    """Return what draws the rig's frames, with the noise of its camera."""
    from beam_ros.vision.rendering.frames import SceneRenderer

    seed = rig.simulation.seed
    rng = np.random.default_rng(seed)
    renderer = SceneRenderer(
        film.camera,
        rig.markers.heights,
        strip_heights=film.strip_heights,
        seed=seed,
        full_well=rig.simulation.full_well,
    )
    return lambda exposure: renderer.render(exposure.markers, rng, exposure.strip)


def _tracked(rig: Rig, film: Film, types: BagTypes) -> Measure:
    from beam_ros.vision.calibration.storage import calibration_or_nominal
    from beam_ros.vision.errors import CalibrationError
    from beam_ros.vision.measurement.measuring_chain import MeasuringChain

    names, heights = rig.markers.names, rig.markers.heights
    render = rendered(rig, film)
    camera = film.camera
    calibration = calibration_or_nominal(rig.tracker.calibration, camera, len(names))
    chain = MeasuringChain(camera, rig.tracker_parameters(), heights, calibration, rig.beam_motion())
    if chain.calibration_fault or chain.lens_fault:
        raise CalibrationError(f"{rig.tracker.calibration}: {chain.calibration_fault or chain.lens_fault}")

    def measure(exposure: Exposure) -> Iterator[tuple[str, Any]]:
        frame = render(exposure)
        if rig.recorder.images:
            yield from image_messages(types, exposure.stamp_ns, frame)
        seen = chain.measure(exposure.stamp_ns, frame)
        found = seen.displacement
        for _, message in messages.displacement_messages(types, names, seen.stamps_ns, found.x_m):
            yield "beam/displacement", message
        yield (
            "beam/markers",
            messages.marker_cloud_from_columns(
                types, seen.stamp_ns, heights, found.x_m, found.sigma_m, seen.u_px, seen.v_px
            ),
        )

    return measure
