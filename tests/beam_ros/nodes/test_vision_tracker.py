"""The tracker as a process: frames in, displacements out, and bad frames flagged while it lives on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beam_ros import interfaces, messages
from beam_ros.rig import Rig

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")
pytest.importorskip("cv2")


@pytest.fixture
def tracker(executables, graph):
    executables.start("vision_tracker", "--ros-args")
    graph.images = graph.publisher("camera/image_raw", interfaces.QualityOfService(5, is_reliable=False))
    graph.seen, graph.clouds = [], []
    graph.listen("beam/displacement", lambda m: graph.seen.append(messages.read_displacement(m)))
    graph.listen("beam/markers", lambda m: graph.clouds.append(messages.read_marker_cloud(m)))
    graph.wait(lambda: graph.images.get_subscription_count() > 0, "the tracker's subscription", 20.0)
    return graph


def _frames():
    from beam_ros.vision.rendering import SceneRenderer

    rig = Rig.from_file()
    renderer = SceneRenderer(rig.camera_parameters(), rig.numbers("markers.heights"))
    rng = np.random.default_rng(0)
    return lambda x: renderer.render(np.full(3, x), rng)


def test_a_best_effort_camera_is_matched_and_displacements_are_right_to_micrometres(tracker) -> None:
    frame = _frames()
    stamp = tracker.node.get_clock().now().nanoseconds
    for k in range(30):
        tracker.images.publish(messages.image(tracker.types, stamp + k * 10_000_000, frame(1e-3)))
        tracker.spin(0.01)
    tracker.wait(lambda: len(tracker.seen) >= 20, "displacements")
    mean = np.mean([d.positions for d in tracker.seen], axis=0)
    assert tracker.seen[0].names == ("z010", "z225", "z285")
    assert mean == pytest.approx([1e-3] * 3, abs=3e-6)  # 4 um a frame, 20 frames, bias below 0.002 px
    rows = tracker.clouds[-1].rows
    assert np.all(rows["valid"] == 1)
    assert np.all((rows["sigma_m"] > 1e-6) & (rows["sigma_m"] < 1e-5))


def test_bad_frames_give_nan_and_the_node_lives_on(tracker) -> None:
    frame = _frames()
    stamp = tracker.node.get_clock().now().nanoseconds
    good = messages.image(tracker.types, stamp, frame(0.0))
    truncated = messages.image(tracker.types, stamp + 1, frame(0.0))
    truncated.data = truncated.data[:1000]
    unknown = messages.image(tracker.types, stamp + 2, frame(0.0))
    unknown.encoding = "yuv9"
    small = messages.image(tracker.types, stamp + 3, np.zeros((100, 100), np.uint8))
    black = messages.image(tracker.types, stamp + 4, np.zeros((480, 640), np.uint8))
    white = messages.image(tracker.types, stamp + 5, np.full((480, 640), 255, np.uint8))
    again = messages.image(tracker.types, stamp + 6, frame(0.0))
    for message in (good, truncated, unknown, small, black, white, again):
        count = len(tracker.seen)
        tracker.images.publish(message)
        tracker.wait(lambda count=count: len(tracker.seen) > count, "an answer to the frame")
    seen = [all(math.isfinite(x) for x in d.positions) for d in tracker.seen]
    assert seen == [True, False, False, False, False, False, True]


def test_calibration_against_the_hubs_encoder_finds_scale_and_zero(tracker) -> None:
    """Five positions of the hub, a camera that is really at 1480 px/m: the fit finds it, tare sets the zero."""
    from beam_ros.vision.rendering import SceneRenderer

    rig = Rig.from_file().with_values({"camera.pixels_per_metre": 1480.0, "markers.diameter": 0.012 / 1.48})
    heights = np.array(rig.numbers("markers.heights")) * 1500.0 / 1480.0  # where the tracker looks for them
    renderer = SceneRenderer(rig.camera_parameters(), heights)
    rng = np.random.default_rng(0)
    hub = tracker.publisher("hub/state")
    tracker.wait(lambda: hub.get_subscription_count() > 0, "hub/state's listener")
    stamp = tracker.node.get_clock().now().nanoseconds

    def average(service: str, x: float):
        nonlocal stamp
        service_class = tracker.types.service_class(interfaces.SERVICES[service].type_name)
        client = tracker.node.create_client(service_class, service)
        tracker.wait(client.service_is_ready, service)
        future = client.call_async(service_class.Request())
        frame = renderer.render(np.full(3, x), rng)
        while not future.done():
            stamp += 10_000_000
            hub.publish(messages.hub_state(tracker.types, messages.HubSample(stamp, x)))
            tracker.images.publish(messages.image(tracker.types, stamp, frame))
            tracker.spin(0.004)
        return future.result()

    refused = tracker.call("tracker/fit_calibration")
    assert not refused.success
    assert "0 points" in refused.message
    for x in (-0.02, -0.01, 0.0, 0.01, 0.02):
        captured = average("tracker/capture_point", x)
        assert captured.success, captured.message
    fitted = tracker.call("tracker/fit_calibration")
    assert fitted.success, fitted.message
    scales = [float(word) for word in fitted.message.split(" px/m")[0].split(", ")]
    assert scales == pytest.approx([1480.0] * 3, rel=1e-3)
    assert average("tracker/tare", 0.015).success
    tracker.seen.clear()
    tracker.images.publish(
        messages.image(tracker.types, stamp + 10_000_000, renderer.render(np.full(3, 0.015), rng))
    )
    tracker.wait(lambda: bool(tracker.seen), "a displacement")
    # u is absolute: 15 mm from home it reads 15 mm after a tare, too. 5 sd of one frame.
    assert tracker.seen[-1].positions == pytest.approx([0.015] * 3, abs=2e-5)
