"""The tracker as a process: frames in, displacements out, and bad frames flagged while it lives on.

All tests share a few processes, each in a namespace of its own, so that most of the time is not spent on starting.
"""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beam_ros import messages
from beam_ros.interfaces.graph import QualityOfService
from beam_ros.process.environment import child_environment

pytest.importorskip("rclpy")
pytest.importorskip("cv2")

import cv2

from beam_ros.vision.calibration.lens import Lens
from beam_ros.vision.calibration.linear import LinearCalibration
from beam_ros.vision.calibration.storage import load_calibration, save_calibration
from tests.beam_ros.nodes.tracker_scene import TrackerScene
from tests.graph import Graph
from tests.real_processes import Executables

pytestmark = pytest.mark.ros

FILM_FRAMES = 60
MARKERS = ("z010", "z225", "z285")
LENS = Lens((900.0, 905.0), (322.0, 238.0), (-0.21, 0.08, 0.0007, -0.0004, 0.01))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TrackerScene]:
    folder = tmp_path_factory.mktemp("tracker")
    executables = Executables(folder)
    with Graph() as graph:
        scene = TrackerScene(graph, executables, folder)
        foreign = replace(
            LinearCalibration.from_camera(scene.rig.camera_parameters(), 3), image_size=(1280, 960)
        )
        save_calibration(foreign, folder / "foreign.yaml")
        _write_film(scene, folder / "film.avi")
        scene.start("plain")
        scene.start("changing")
        scene.start("foreign", tracker__calibration=folder / "foreign.yaml")
        scene.start(
            "device", tracker__source="device", tracker__device=folder / "video7", tracker__retry_period=0.1
        )
        scene.start(
            "measured",
            tracker__averaged_frames=15,
            tracker__save_calibration=folder / "new.yaml",
            camera__name="lab",
        )
        scene.start("small", tracker__source="compressed")
        scene.start("foretold", tracker__prediction="beam")
        scene.start("failing", program=[sys.executable, str(Path(__file__).with_name("failing_tracker.py"))])
        scene.start("film", tracker__source="file", tracker__video=folder / "film.avi")
        names = {("tracker", f"/{namespace}") for namespace in scene.processes}
        graph.wait(lambda: names <= set(graph.node.get_node_names_and_namespaces()), "every tracker", 40.0)
        try:
            yield scene
        finally:
            executables.close()


def _write_film(scene: TrackerScene, path) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 50.0, (640, 480))
    for k in range(FILM_FRAMES):
        writer.write(cv2.cvtColor(scene.pixels(_film_x(k)), cv2.COLOR_GRAY2BGR))
    writer.release()


def _film_x(k: int) -> float:
    return 1e-3 * math.sin(0.3 * k)


def _is_seen(displacement) -> list[bool]:
    return [math.isfinite(x) for x in displacement.positions]


@pytest.mark.slow
def test_displacements_are_right_to_micrometres_and_say_how_well(scene) -> None:
    seen = [scene.answer("plain", scene.image(scene.pixels(1e-3))) for _ in range(20)]
    assert seen[0].names == ("z010", "z225", "z285")
    # 4 um a frame, 20 frames, bias below 0.002 px = 1.3 um.
    assert np.mean([d.positions for d in seen], axis=0) == pytest.approx([1e-3] * 3, abs=4e-6)
    scene.graph.wait(lambda: len(scene.seen["plain"].clouds) >= 20, "marker clouds")
    rows = scene.seen["plain"].clouds[-1].rows
    assert np.all(rows["valid"] == 1)
    assert np.all((rows["sigma_m"] > 1e-6) & (rows["sigma_m"] < 1e-5))


def test_every_encoding_gives_the_same_positions(scene) -> None:
    grey = scene.pixels([1e-3, -2e-3, 3e-3])
    expected = np.array(scene.answer("plain", scene.image(grey)).positions)
    wide = grey.astype(">u2") * 257
    padded = np.zeros((480, 660), np.uint8)
    padded[:, :640] = grey
    colour = np.repeat(grey[:, :, None], 3, axis=2)
    for changes in (
        {"encoding": "rgb8", "step": 1920, "data": colour.tobytes()},
        {"encoding": "bgr8", "step": 1920, "data": colour.tobytes()},
        {"encoding": "bayer_rggb8"},
        {"step": 660, "data": padded.tobytes()},
        {"encoding": "mono16", "step": 1280, "is_bigendian": 1, "data": wide.tobytes()},
    ):
        if isinstance(changes.get("data"), bytes):
            changes["data"] = scene.graph.types.octets(changes["data"])
        # Other gates and a demosaiced edge: 0.03 px = 20 um.
        for _ in range(3):
            found = scene.answer("plain", scene.image(grey, **changes))
        assert found.positions == pytest.approx(expected, abs=2e-5), changes["encoding"]


def test_compressed_images_are_measured_and_damaged_ones_said(scene) -> None:
    scene.camera("small", topic="camera/image_raw/compressed")

    def answer(x: float, suffix: str, length: int | None = None):
        data = cv2.imencode(suffix, scene.pixels(x))[1].tobytes()[:length]
        return scene.answer("small", messages.compressed_image(scene.graph.types, scene.stamp(), data))

    for suffix in (".jpg", ".png"):
        for x in (-2e-3, 1e-3, 1.5e-3, 1.5e-3):
            assert answer(x, suffix).positions == pytest.approx([x] * 3, abs=3e-5)
    assert _is_seen(answer(1.5e-3, ".jpg", -200)) == [False] * 3
    scene.complaint("small", "damaged or cut off")
    assert _is_seen(answer(1.5e-3, ".bmp")) == [False] * 3
    scene.complaint("small", "expected a JPEG or a PNG")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"data": b"\1" * 1000}, "truncated: 1000 bytes"),
        ({"encoding": "yuv9"}, "'yuv9' is not supported"),
        ({"step": 100}, "step is 100 bytes"),
        ({"height": 100, "width": 100}, "100 x 100; expected 640 x 480"),
        ({"height": 0}, "size is 640 x 0"),
    ],
)
def test_a_frame_that_cannot_be_read_is_an_error_and_nan(scene, changes, words) -> None:
    scene.answer("plain", scene.image(scene.pixels(0.0)))
    if "data" in changes:
        changes = {"data": scene.graph.types.octets(changes["data"])}
    assert _is_seen(scene.answer("plain", scene.image(scene.pixels(0.0), **changes))) == [False] * 3
    health = scene.complaint("plain", words)
    assert int(health.values["unusable frames"]) > 0
    assert "ERROR" in scene.processes["plain"].output()  # throttled: not every reason
    assert _is_seen(scene.answer("plain", scene.image(scene.pixels(0.0)))) == [True] * 3


def test_wire_bytes_cut_anywhere_leave_the_node_alive(scene) -> None:
    from rclpy.serialization import serialize_message

    for length in (4, 15, 30, 60, 70, 5000):
        wire = bytes(serialize_message(scene.image(scene.pixels(0.0))))
        scene.camera("plain").publish(wire[:length])
    scene.complaint("plain", "image message")
    assert _is_seen(scene.answer("plain", scene.image(scene.pixels(0.0)))) == [True] * 3


def test_an_error_of_the_trackers_own_costs_a_frame_and_is_said(scene) -> None:
    bright, black = (scene.pixels(1e-3) for _ in range(2))
    bright[0, 0], black[0, 0] = 30, 0
    for _ in range(3):
        assert _is_seen(scene.answer("failing", scene.image(bright))) == [True] * 3
        assert _is_seen(scene.answer("failing", scene.image(black))) == [False] * 3
    scene.complaint("failing", "ZeroDivisionError")
    said = scene.processes["failing"].output()
    assert "of failing_tracker.py; expected" in said
    assert "report it with the frame" in said
    assert "Traceback" not in said
    assert _is_seen(scene.answer("failing", scene.image(bright))) == [True] * 3


def test_black_white_and_empty_frames_are_nan_and_the_markers_are_found_again_at_once(scene) -> None:
    empty = np.full((480, 640), 30, np.uint8)
    for pixels in (np.zeros_like(empty), np.full_like(empty, 255), empty):
        assert _is_seen(scene.answer("plain", scene.image(pixels))) == [False] * 3
    scene.complaint("plain", "not in sight: z010", "WARN")
    scene.answer("plain", scene.image(scene.pixels(0.0)))
    assert _is_seen(scene.answer("plain", scene.image(scene.pixels(0.0)))) == [True] * 3


@pytest.mark.slow
def test_a_marker_with_a_twin_is_nobody_until_the_twin_has_gone(scene) -> None:
    frame = scene.pixels(0.0)
    twin = frame.copy()
    row = round(465 - 1500 * 0.225)
    # Within the beam's reach: what it cannot bend to is told from the marker at once.
    twin[row - 20 : row + 20, 350:410] = frame[row - 20 : row + 20, 290:350]
    assert scene.graph.call("tracker/reset", "/plain").success
    for _ in range(5):
        assert _is_seen(scene.answer("plain", scene.image(twin))) == [True, False, True]
    # One of two was never known to be the marker: what is left has to stay for a while.
    later = [scene.answer("plain", scene.image(frame)) for _ in range(220)]
    assert later[-1].positions == pytest.approx([0.0] * 3, abs=3e-5)


def test_a_repeated_frame_is_answered_once_and_counted(scene) -> None:
    seen = scene.seen["plain"]
    message = scene.image(scene.pixels(0.0))
    scene.answer("plain", message)
    count = len(seen.displacements)
    scene.camera("plain").publish(message)
    scene.answer("plain", scene.image(scene.pixels(0.0)))
    assert len(seen.displacements) == count + 1
    health = scene.complaint("plain", "came twice", "WARN")
    assert int(health.values["repeated frames"]) >= 1


@pytest.mark.slow
def test_diagnostics_say_rate_latency_noise_and_losses(scene) -> None:
    seen = scene.seen["plain"]

    def told() -> dict[str, float]:
        return {name: float(value) for name, value in seen.health[-1].values.items() if value}

    # A marker that seemed out of round as it was found is doubted for some 130 frames, on a busy computer for more.
    end = time.monotonic() + 120.0
    while not (seen.health and all(told().get(f"{name} sigma_px", 1.0) < 0.01 for name in MARKERS)):
        assert time.monotonic() < end, told()
        scene.answer("plain", scene.image(scene.pixels(0.0)))
    values = told()
    assert values["rate_hz"] > 0.0
    assert 0.0 < values["latency_median_ms"] <= values["latency_p99_ms"]
    for name in MARKERS:
        assert values[f"{name} noise_grey"] == pytest.approx(2.0, rel=0.3)
        assert values[f"{name} sigma_px"] > 0.003
        assert values[f"{name} lost"] >= 0
    assert {"dropped frames", "repeated frames", "unusable frames"} <= set(values)


def test_drawings_are_made_while_somebody_looks(scene) -> None:
    graph = scene.graph
    images, shapes = [], []
    graph.listen("tracker/debug_image", images.append, namespace="/plain")
    graph.listen("beam/shape", shapes.append, namespace="/plain")

    def film() -> bool:
        scene.camera("plain").publish(scene.image(scene.pixels(2e-3)))
        return bool(images and shapes and shapes[-1].points)

    graph.wait(film, "drawings")
    image, shape = images[-1], shapes[-1]
    assert (image.encoding, image.width, image.height, image.step) == ("bgr8", 640, 480, 1920)
    colours = np.frombuffer(image.data, np.uint8).reshape(480, 640, 3)
    assert np.any(colours[:, :, 1] > colours[:, :, 0].astype(int) + 50)  # green circles
    assert (shape.header.frame_id, shape.type) == ("rig", shape.LINE_STRIP)
    assert [point.x for point in shape.points] == pytest.approx([2e-3] * len(shape.points), abs=5e-4)
    assert shape.points[-1].z == pytest.approx(0.3)


@pytest.mark.slow
def test_a_camera_that_comes_back_with_another_quality_of_service_is_heard(scene) -> None:
    """Reliable and volatile; then another process, best effort and latched; killed; then reliable again."""
    seen = scene.seen["changing"]
    scene.answer("changing", scene.image(scene.pixels(0.0)))
    scene.end_camera("changing")
    camera = subprocess.Popen(
        [sys.executable, "-m", "tests.beam_ros.nodes.best_effort_camera", "/changing/camera/image_raw"],
        cwd=Path(__file__).parents[3],
        env=child_environment(),
        start_new_session=True,
    )
    try:
        count = len(seen.displacements)
        scene.graph.wait(lambda: len(seen.displacements) >= count + 10, "frames of the other camera", 20.0)
    finally:
        os.kill(camera.pid, signal.SIGKILL)
        camera.wait()
    assert seen.displacements[-1].positions == pytest.approx([1e-3] * 3, abs=3e-5)
    scene.until_quiet("changing")
    scene.answer("changing", scene.image(scene.pixels(-1e-3)))
    scene.answer("changing", scene.image(scene.pixels(-1e-3)))
    assert scene.answer("changing", scene.image(scene.pixels(-1e-3))).positions == pytest.approx(
        [-1e-3] * 3, abs=3e-5
    )


def test_the_lens_of_camera_info_is_undone(scene) -> None:
    from beam_ros.vision.rendering.frames import SceneRenderer

    graph = scene.graph
    info = messages.camera_info(graph.types, scene.stamp(), 640, 480)
    info.k = np.array([900.0, 0, 322.0, 0, 905.0, 238.0, 0, 0, 1])
    info.d = graph.types.floats(LENS.distortion)
    # As calibrated cameras often do: said once, before anybody listens.
    latched = QualityOfService(1, is_latched=True)
    publisher = graph.publisher("camera/camera_info", latched, "/changing")
    publisher.publish(info)
    graph.wait(lambda: publisher.get_subscription_count() > 0, "camera_info's listener")
    renderer = SceneRenderer(scene.rig.camera_parameters(), scene.heights, lens=LENS)
    frame = renderer.render(np.full(3, -0.15), np.random.default_rng(0))
    graph.wait(lambda: publisher.get_subscription_count() == 0, "camera_info to be known")
    graph.call("tracker/reset", "/changing")
    assert scene.answer("changing", scene.image(frame)).positions == pytest.approx([-0.15] * 3, abs=4e-5)
    # A lens that cannot be used is none, not the one before.
    info.distortion_model = "unheard_of"
    publisher.publish(info)
    graph.call("tracker/reset", "/changing")
    graph.wait(lambda: publisher.get_subscription_count() > 0, "camera_info's listener")
    graph.wait(lambda: publisher.get_subscription_count() == 0, "camera_info to be known")
    bent = scene.answer("changing", scene.image(frame)).positions
    assert np.min(np.abs(np.array(bent) + 0.15)) > 1e-3
    graph.node.destroy_publisher(publisher)


def test_a_calibration_of_another_camera_gives_pixels_but_no_metres(scene) -> None:
    found = scene.answer("foreign", scene.image(scene.pixels(0.0)))
    assert _is_seen(found) == [False] * 3
    scene.graph.wait(lambda: bool(scene.seen["foreign"].clouds), "a marker cloud")
    rows = scene.seen["foreign"].clouds[-1].rows
    assert np.all(rows["valid"] == 1)
    assert np.all(np.isnan(rows["x_m"]))
    scene.complaint("foreign", "expected 1280 x 960")
    refused = scene.graph.call("tracker/tare", "/foreign")
    assert not refused.success
    assert "1280 x 960" in refused.message


@pytest.mark.slow
def test_a_device_that_is_missing_comes_and_vanishes_is_said_and_the_node_lives_on(scene) -> None:
    seen = scene.seen["device"]
    device = scene.folder / "video7"
    scene.complaint("device", "video7 is not there")
    shutil.copy(scene.folder / "film.avi", device)
    scene.graph.wait(lambda: len(seen.displacements) >= 20, "displacements")
    scene.complaint("device", "set it to arrival", "WARN")
    device.unlink()
    seen.health.clear()
    scene.complaint("device", "video7 is not there")
    assert scene.processes["device"].process.poll() is None
    assert "video7 is not there" in scene.processes["device"].output()
    finite = [d.positions for d in seen.displacements if all(map(math.isfinite, d.positions))]
    assert len(finite) >= 15
    assert np.max(np.abs(finite)) < 1.1e-3


def test_a_video_is_measured_to_its_end_and_the_end_is_said(scene) -> None:
    seen = scene.seen["film"]
    scene.complaint("film", f"has ended after {FILM_FRAMES} frames", "OK")
    found = np.array([d.positions for d in seen.displacements])
    truth = np.array([_film_x(k) for k in range(FILM_FRAMES)])
    # Compressed: 0.1 px.
    assert found == pytest.approx(np.tile(truth[:, None], (1, 3)), abs=7e-5)
    assert np.all(np.diff([d.stamp_ns for d in seen.displacements]) == 20_000_000)


@pytest.mark.slow
def test_a_tracker_that_foretells_hears_the_hub_and_tells_how_often_that_was_needed(scene) -> None:
    graph = scene.graph
    hub = graph.publisher("hub/state", namespace="/foretold")
    graph.wait(lambda: hub.get_subscription_count() > 0, "hub/state's listener")
    for k in range(40):
        x = 2e-5 * k
        hub.publish(messages.hub_state(graph.types, messages.HubSample(scene.stamp(), x)))
        assert _is_seen(scene.answer("foretold", scene.image(scene.pixels(x)))) == [True] * 3
    health = scene.seen["foretold"].health
    graph.wait(lambda: health and "z285 sigma_px" in health[-1].values, "diagnostics of the frames")
    assert [health[-1].values[f"{name} foretold"] for name in ("z010", "z225", "z285")] == ["0"] * 3
    graph.node.destroy_publisher(hub)


def test_a_hub_state_that_cannot_be_read_is_left_out(scene) -> None:
    graph = scene.graph
    hub = graph.publisher("hub/state", namespace="/plain")
    graph.wait(lambda: hub.get_subscription_count() > 0, "hub/state's listener")
    message = messages.hub_state(graph.types, messages.HubSample(scene.stamp(), 0.0))
    message.name = ["hub", "elbow"]
    hub.publish(message)
    graph.wait(lambda: "hub/state is left out" in scene.processes["plain"].output(), "the log to say so")
    assert _is_seen(scene.answer("plain", scene.image(scene.pixels(0.0)))) == [True] * 3
    graph.node.destroy_publisher(hub)


@pytest.mark.slow
def test_calibration_against_the_hubs_encoder_finds_scale_zero_and_their_deviations(scene) -> None:
    """Positions of the hub, a camera that is really at 1480 px/m: the fit finds it, tare sets the zero."""
    from beam_ros.vision.rendering.frames import SceneRenderer

    graph = scene.graph
    rig = scene.rig.with_values({"camera.pixels_per_metre": 1480.0, "markers.diameter": 0.012 / 1.48})
    heights = scene.heights * 1500.0 / 1480.0  # where the tracker looks for them
    renderer = SceneRenderer(rig.camera_parameters(), heights)
    rng = np.random.default_rng(0)
    hub = graph.publisher("hub/state", namespace="/measured")
    graph.wait(lambda: hub.get_subscription_count() > 0, "hub/state's listener")
    camera = scene.camera("measured")

    def average(service: str, x: float, *, hub_speaks: bool = True):
        future = graph.request(service, "/measured")
        frames = [renderer.render(np.full(3, x), rng) for _ in range(4)]
        k = 0
        while not future.done():
            if hub_speaks:
                hub.publish(messages.hub_state(graph.types, messages.HubSample(scene.stamp(), x)))
            camera.publish(scene.image(frames[k % 4]))
            k += 1
            graph.spin(0.02)
        return future.result()

    refused = graph.call("tracker/fit_calibration", "/measured")
    assert not refused.success
    assert "0 points" in refused.message
    refused = average("tracker/capture_point", -0.02, hub_speaks=False)
    assert not refused.success
    assert "the hub has sent nothing yet" in refused.message
    # Discovery may take its time: until the hub is heard, its silence is the answer.
    graph.wait(
        lambda: average("tracker/capture_point", -0.02).success, "a point with the hub's position", 20.0
    )
    for x in (-0.01, 0.0, 0.01, 0.02, 0.01, 0.0):
        captured = average("tracker/capture_point", x)
        assert captured.success, captured.message
    fitted = graph.call("tracker/fit_calibration", "/measured")
    assert fitted.success, fitted.message
    kept = load_calibration(scene.folder / "new.yaml")
    deviations = np.sqrt([covariance[0][0] for covariance in kept.covariance])
    # 4 frames over and over: half the noise of one, which the deviations of 15 frames do not know.
    assert np.all(np.abs(np.array(kept.pixels_per_metre) - 1480.0) < 4 * 3 * deviations)
    assert np.all(deviations < 0.5)
    assert f"{kept.pixels_per_metre[0]:.2f} +- " in fitted.message
    assert (kept.image_size, kept.camera_name) == ((640, 480), "lab")
    assert kept.provenance["n_points"] == 7
    assert {"date", "reference", "reference_sd_m", "lens", "markers", "residual_rms_px"} <= set(
        kept.provenance
    )
    assert average("tracker/tare", 0.015).success
    answer = scene.answer("measured", scene.image(renderer.render(np.full(3, 0.015), rng)))
    # u is absolute: 15 mm from home it reads 15 mm after a tare, too. 5 sd of one frame.
    assert answer.positions == pytest.approx([0.015] * 3, abs=2e-5)
    scene.graph.wait(
        lambda: scene.seen["measured"].clouds[-1].stamp_ns == answer.stamp_ns, "the frame's marker cloud"
    )
    rows = scene.seen["measured"].clouds[-1].rows
    # Far from its zero the scale's deviation is part of the displacement's.
    assert np.all(rows["sigma_m"] > 0.015 * deviations / 1480.0)
    # The hub may be elsewhere by now.
    graph.spin(1.2)
    for service in ("tracker/tare", "tracker/capture_point"):
        refused = average(service, 0.015, hub_speaks=False)
        assert not refused.success
        assert "the hub has sent nothing for " in refused.message
    answer = scene.answer("measured", scene.image(renderer.render(np.full(3, 0.015), rng)))
    assert answer.positions == pytest.approx([0.015] * 3, abs=2e-5)
