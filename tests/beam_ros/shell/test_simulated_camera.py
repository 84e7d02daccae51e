"""What is published says when it was seen: stamps against a hub whose motion is known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.messages import BagTypes, read_displacement
from beam_ros.messages.stamps import stamp_ns
from beam_ros.rig.rig import Rig
from beam_ros.vision.camera.images import uncompressed

pytest.importorskip("rclpy", reason="the shell needs rclpy")
from beam_ros.shell.simulated_camera import SimulatedCamera

START = 1_700_000_000_000_000_000
SPEED = 0.2  # [m/s]: a frame stamped 1 ms late shows a hub 0.3 px away
EXPOSURE_S, READOUT_S, LATENCY_S = 0.002, 0.006, 0.003
TURNS = 50  # in each of them a few frames are drawn


def published(
    with_images: bool, until_ns: int = 50_000_000, n_listeners: int = 0, **values: object
) -> tuple[Rig, dict[str, list], SimulatedCamera]:
    """Film a hub that travels at a constant speed, the beam straight; return what came on each topic."""
    quiet = {"simulation.displacement_noise": 0.0, "camera.noise": 0.0}
    rig = Rig.from_file().with_values({"camera.exposure": EXPOSURE_S, **quiet, **values})
    model, came = rig.beam_model(), {}

    def snapshots(stamps) -> Snapshots:
        times = np.asarray(stamps, dtype=np.int64)
        zero = np.zeros(len(times))
        return Snapshots(
            times, SPEED * (times - START) * 1e-9, zero, zero, np.zeros((len(times), model.n_modes))
        )

    def offer(topic: str) -> SimpleNamespace:
        return SimpleNamespace(
            publish=came.setdefault(topic, []).append, get_subscription_count=lambda: n_listeners
        )

    node = SimpleNamespace(rig=rig, types=BagTypes(), offer=offer)
    camera = SimulatedCamera(node, model, snapshots, START, with_images=with_images)
    for _ in range(TURNS):
        camera.publish_until(START + until_ns)
    return rig, came, camera


# From the stamp to the beginning of the first row's exposure [s].
BEGINS = {"start": 0.0, "mid": -0.5 * (READOUT_S + EXPOSURE_S), "end": -(READOUT_S + EXPOSURE_S)}


@pytest.mark.parametrize("meaning", BEGINS)
def test_an_image_shows_every_marker_where_the_hub_was_when_its_row_was_exposed(meaning) -> None:
    rig, came, _ = published(
        True, **{"camera.readout": READOUT_S, "camera.stamp": meaning, "camera.latency": LATENCY_S}
    )
    camera = rig.camera_parameters()
    images, infos = came["camera/image_raw"], came["camera/camera_info"]
    assert [stamp_ns(image) for image in images] == [stamp_ns(info) for info in infos]
    assert len(images) == 5
    assert set(np.diff([stamp_ns(image) for image in images])) == {10_000_000}
    for image in images:
        pixels = np.asarray(image.data).reshape(image.height, image.width).astype(float)
        bright = np.where(pixels > camera.background + 40.0, pixels - camera.background, 0.0)
        for height in rig.markers.heights:
            row = camera.origin_px[1] - camera.pixels_per_metre * height
            around = bright[round(row) - 8 : round(row) + 9]
            column = np.sum(around * np.arange(image.width)) / np.sum(around)
            opens = (stamp_ns(image) - START) * 1e-9 - LATENCY_S + BEGINS[meaning]
            middle = opens + READOUT_S * row / (camera.height - 1) + 0.5 * EXPOSURE_S
            # 0.03 px are 0.1 ms at this speed: rounding to grey levels, and the rows that a marker covers.
            assert column == pytest.approx(
                camera.origin_px[0] + camera.pixels_per_metre * SPEED * middle, abs=0.03
            )


def test_compressed_images_are_those_of_the_other_topic_and_sent_while_somebody_listens() -> None:
    came = published(True, n_listeners=1)[1]
    images, compressed = came["camera/image_raw"], came["camera/image_raw/compressed"]
    assert [stamp_ns(image) for image in compressed] == [stamp_ns(image) for image in images]
    for image, small in zip(images, compressed, strict=True):
        pixels = np.asarray(image.data).reshape(image.height, image.width)
        seen = uncompressed(small.data, small.format)
        assert np.abs(seen.astype(int) - pixels).max() <= 12
        assert len(small.data) < pixels.size / 10
    assert published(True)[1]["camera/image_raw/compressed"] == []


@pytest.mark.parametrize("readout", [0.0, READOUT_S])
def test_a_displacement_is_stamped_in_the_middle_of_its_exposure(readout) -> None:
    rig, came, _ = published(False, **{"camera.readout": readout})
    found = [read_displacement(message) for message in came["beam/displacement"]]
    assert len(found) == 5 * (1 if readout == 0.0 else len(rig.markers.names))
    for one in found:
        np.testing.assert_allclose(one.positions, SPEED * (one.stamp_ns - START) * 1e-9, atol=1e-9)
    assert found[-1].stamp_ns - START == pytest.approx(40e6 + (1e6 if readout == 0.0 else 7e6), abs=1.2e6)


def test_a_simulation_that_falls_behind_says_so_and_one_that_keeps_up_is_well() -> None:
    _, _, camera = published(False)
    camera.note_lag(0.02)
    assert camera.health() == (
        "OK",
        "",
        {"hardware": "ideal", "frames": 5, "dropped frames": 0, "frames left out": 0, "lag": 0.02},
    )
    camera.note_lag(0.3)
    camera.note_lag(0.05)
    level, sentence, _ = camera.health()
    assert (level, sentence) == ("WARN", "the simulation falls behind: 0.30 s behind real time")
    # A lag is told once; lost frames are told to the end, since the recording lacks them.
    assert camera.health()[0] == "OK"
    _, came, late = published(False, 2_000_000_000)
    for _ in range(2):
        level, sentence, counters = late.health()
        lost = counters["dropped frames"]
        assert lost == 200 - len(came["beam/displacement"]) > 100
        assert (level, sentence) == (
            "WARN",
            f"the simulation falls behind: {lost} frames were lost because this computer fell behind",
        )


def test_commands_do_not_wait_for_the_whole_film_and_for_less_of_it_where_the_rig_is_behind() -> None:
    _, came, camera = published(False)
    frames = came["beam/displacement"]

    def turn() -> int:
        before = len(frames)
        camera.publish_until(START + 400_000_000)
        return len(frames) - before

    at_ease = turn()
    assert 1 < at_ease < 10
    camera.note_lag(0.1)
    assert 1 <= turn() < at_ease
    camera.note_lag(0.0)
    assert turn() == at_ease
