from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.rendering.disturbances import Disturbances, Occluder, SecondSpot
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.marker_state import MarkerMotion, shared
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

HEIGHTS = (0.010, 0.1, 0.225, 0.285)
STEADY = 35
PIXEL = 1.0 / 1500.0


def make(heights=HEIGHTS, **changes):
    camera = packaged_camera()
    tracker = MarkerTracker(packaged_tracker(camera, heights, **changes), len(heights))
    return camera, SceneRenderer(camera, heights), tracker


def swing(k: int, n_markers: int = 4) -> np.ndarray:
    """Displacement of the markers in frame k [m]: 4.5 px at most, as of a beam that rings."""
    return 0.003 * np.sin(0.28 * k + 0.3 * np.arange(n_markers))


def settle(renderer: SceneRenderer, tracker: MarkerTracker, rng, offset=0.0, disturbances=None) -> None:
    n_markers = tracker.n_markers
    for k in range(STEADY):
        frame = renderer.render(swing(k, n_markers) + offset, rng, disturbances=disturbances)
        tracker.process(frame, k)
    assert tracker.lost_frames == (0,) * n_markers


def frames_lost(camera, renderer, tracker, rng, offset, n_frames=12, z=None, disturbances=None) -> list[int]:
    """Numbers of frames not valid of each marker after a jump; every valid one must be true, and stay valid."""
    n_markers = tracker.n_markers
    valid = np.zeros((n_frames, n_markers), dtype=bool)
    for k in range(n_frames):
        x = swing(STEADY + k, n_markers) + offset
        frame = renderer.render(x, rng, marker_z=z, disturbances=disturbances)
        for j, marker in enumerate(tracker.process(frame, STEADY + k).markers):
            valid[k, j] = marker.is_valid
            if marker.is_valid:
                assert marker.u_px == pytest.approx(float(camera.columns(x[j])), abs=0.05)
    return [int(np.argmax(column)) if column.any() else n_frames for column in valid.T]


@pytest.mark.first_case
@pytest.mark.parametrize("n_markers", [2, 3, 4])
@pytest.mark.parametrize(
    ("start_px", "jump_px"),
    [(0, 20), (0, 24), (0, 30), (0, -45), (0, 80), (0, -100), (0, 131), (0, 290), (-290, 580), (290, -580)],
)
def test_a_jump_of_all_markers_costs_nothing(start_px, jump_px, n_markers):
    camera, renderer, tracker = make(HEIGHTS[:n_markers])
    rng = np.random.default_rng(71)
    settle(renderer, tracker, rng, start_px * PIXEL)
    assert frames_lost(camera, renderer, tracker, rng, (start_px + jump_px) * PIXEL) == [0] * n_markers


def test_jumps_in_a_row_are_found_every_time():
    camera, renderer, tracker = make()
    rng = np.random.default_rng(72)
    settle(renderer, tracker, rng)
    for offset_px in (60, -200, -60, 250, 200, 0, 35):
        assert max(frames_lost(camera, renderer, tracker, rng, offset_px * PIXEL, n_frames=4)) <= 1


@pytest.mark.first_case
@pytest.mark.parametrize("rows_px", [4.0, 8.0, -13.0])
@pytest.mark.parametrize("jump_px", [0.0, 150.0])
@pytest.mark.parametrize("expects_rows", [True, False])
def test_a_camera_kicked_across_the_rows_is_followed_within_the_rows_tolerance(
    rows_px, jump_px, expects_rows
):
    camera, renderer, tracker = make()
    if not expects_rows:
        tracker = MarkerTracker(packaged_tracker(), len(HEIGHTS))
    rng = np.random.default_rng(73)
    settle(renderer, tracker, rng)
    z = np.array(HEIGHTS) - rows_px * PIXEL
    assert max(frames_lost(camera, renderer, tracker, rng, jump_px * PIXEL, z=z)) <= 1
    # Kicked back, and lost one at a time, they are in the rows that are now theirs.
    assert max(frames_lost(camera, renderer, tracker, rng, 0.0)) <= 1


def test_markers_in_rows_that_the_rig_file_excludes_are_not_taken():
    camera, renderer, tracker = make()
    rng = np.random.default_rng(74)
    settle(renderer, tracker, rng)
    z = np.array(HEIGHTS) - 25 * PIXEL
    assert frames_lost(camera, renderer, tracker, rng, 0.0, z=z) == [12] * 4


@pytest.mark.slow
def test_a_smeared_frame_between_costs_itself_and_one_more():
    camera, renderer, tracker = make()
    rng = np.random.default_rng(75)
    for jump_px in (40.0, -60.0, 200.0):
        tracker.reset()
        settle(renderer, tracker, rng)
        smeared = swing(STEADY)[None, :] + np.linspace(0.0, jump_px * PIXEL, 6)[:, None]
        result = tracker.process(renderer.render(smeared, rng), STEADY)
        assert not any(marker.is_valid for marker in result.markers)
        assert max(frames_lost(camera, renderer, tracker, rng, jump_px * PIXEL)) <= 1


@pytest.mark.slow
def test_markers_hidden_together_are_found_wherever_they_come_back():
    camera, renderer, tracker = make()
    rng = np.random.default_rng(76)
    for hidden_frames, jump_px in ((20, 0), (20, 200), (150, 200)):
        tracker.reset()
        settle(renderer, tracker, rng)
        for k in range(hidden_frames):
            result = tracker.process(renderer.render(np.full(4, np.nan), rng), k)
            assert not any(marker.is_valid for marker in result.markers)
        lost = frames_lost(camera, renderer, tracker, rng, jump_px * PIXEL)
        assert max(lost) <= (1 if jump_px else 0)


def test_a_step_that_leaves_one_marker_within_reach_is_found():
    camera, renderer, tracker = make(HEIGHTS[:3])
    rng = np.random.default_rng(77)
    settle(renderer, tracker, rng)
    assert max(frames_lost(camera, renderer, tracker, rng, np.array([45, 35, 20]) * PIXEL)) <= 1


def test_one_marker_that_stays_hidden_does_not_keep_the_others():
    camera, renderer, tracker = make()
    rng = np.random.default_rng(78)
    settle(renderer, tracker, rng)
    hidden = Disturbances(
        occluders=(Occluder(0, camera.rows(0.225) - 15, 640, camera.rows(0.225) + 15, 30.0),)
    )
    for k in range(20):
        tracker.process(renderer.render(swing(k), rng, disturbances=hidden), k)
    lost = frames_lost(camera, renderer, tracker, rng, 90 * PIXEL, disturbances=hidden)
    assert [lost[0], lost[1], lost[3]] == [0, 0, 0]
    assert lost[2] == 12


@pytest.mark.slow
@pytest.mark.parametrize("n_markers", [1, 2, 3, 4])
@pytest.mark.parametrize("distance_px", [60, 250])
@pytest.mark.parametrize("was_there", [True, False])
def test_a_twin_is_not_taken_for_a_marker_while_all_are_hidden(n_markers, distance_px, was_there):
    camera, renderer, tracker = make(HEIGHTS[:n_markers])
    rng = np.random.default_rng(79)
    twin = Disturbances(spots=(SecondSpot(320.0 + distance_px, float(camera.rows(HEIGHTS[0]))),))
    settle(renderer, tracker, rng)
    if was_there:
        for k in range(70):
            tracker.process(renderer.render(swing(k, n_markers), rng, disturbances=twin), k)
    for k in range(8):
        result = tracker.process(renderer.render(np.full(n_markers, np.nan), rng, disturbances=twin), k)
        assert not any(marker.is_valid for marker in result.markers), (k, result)
    result = tracker.process(renderer.render(np.zeros(n_markers), rng, disturbances=twin), 0)
    assert [marker.u_px for marker in result.markers] == pytest.approx([320.0] * n_markers, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("distance_px", [90, -260])
def test_a_mirror_image_of_the_beam_is_not_taken_for_it_while_the_beam_is_hidden(distance_px):
    camera, renderer, tracker = make()
    rng = np.random.default_rng(80)
    mirrored = Disturbances(
        spots=tuple(SecondSpot(320.0 + distance_px, float(row)) for row in camera.rows(HEIGHTS))
    )
    settle(renderer, tracker, rng)
    for k in range(70):
        assert tracker.process(renderer.render(swing(k), rng, disturbances=mirrored), k).is_complete
    for k in range(20):
        result = tracker.process(renderer.render(np.full(4, np.nan), rng, disturbances=mirrored), k)
        assert not any(marker.is_valid for marker in result.markers)
    result = tracker.process(renderer.render(np.zeros(4), rng, disturbances=mirrored), 0)
    assert [marker.u_px for marker in result.markers] == pytest.approx([320.0] * 4, abs=0.05)


def test_two_spots_in_a_marker_row_after_a_jump_leave_that_marker_lost():
    camera, renderer, tracker = make()
    rng = np.random.default_rng(81)
    settle(renderer, tracker, rng)
    twin = Disturbances(spots=(SecondSpot(120.0, float(camera.rows(HEIGHTS[1]))),))
    lost = frames_lost(camera, renderer, tracker, rng, 150 * PIXEL, disturbances=twin)
    assert lost == [0, 12, 0, 0]


def test_what_took_a_lost_marker_place_before_the_others_jumped_is_no_part_of_the_jump():
    camera, renderer, tracker = make()
    rng = np.random.default_rng(82)
    settle(renderer, tracker, rng)
    twin = Disturbances(spots=(SecondSpot(320.0 + 110.0, float(camera.rows(HEIGHTS[0]))),))
    for k in range(40):
        kick = 150 * PIXEL if k >= 20 else 0.0
        x = swing(k) + kick
        x[0] = np.nan
        result = tracker.process(renderer.render(x, rng, disturbances=twin), k)
        assert [marker.is_valid for marker in result.markers] == [False, True, True, True]


def cubic(k: int) -> float:
    return 1.0 + 0.5 * k - 0.3 * k**2 + 0.1 * k**3


def cubic_motion(n_places: int) -> MarkerMotion:
    """Return a marker that was seen in so many frames of a cubic motion, from frame 0 on."""
    marker = MarkerMotion()
    for k in range(n_places):
        marker.remember(cubic(k), 0.0, k, is_fresh=k == 0)
    return marker


def test_the_speed_of_a_cubic_motion_is_its_slope():
    speed, doubt = cubic_motion(5).speed(cubic(5), 0)
    assert speed == pytest.approx(0.5 - 0.6 * 5 + 0.3 * 25)
    # Second differences, -0.6 + 0.6 (k - 1), are 1.8; third ones 0.6. Half of one is more than a third of the other.
    assert doubt == pytest.approx(0.9)


def test_the_speed_of_a_marker_is_as_uncertain_as_it_has_been_seen_in_few_frames():
    first, second = cubic(1) - cubic(0), cubic(2) - cubic(1)
    assert cubic_motion(1).speed(cubic(1), 0) == pytest.approx((first, abs(first)))
    change = second - first
    assert cubic_motion(2).speed(cubic(2), 0) == pytest.approx((second + change / 2, abs(change)))


@pytest.mark.parametrize("frequency", [0.02, 0.1, 0.2, 0.25, 0.3, 0.4])
def test_the_speed_of_a_sine_lies_below_what_its_steps_allow(frequency):
    omega = 2 * np.pi * frequency
    for phase in np.linspace(0, np.pi, 50):
        places = np.sin(omega * np.arange(5) + phase)
        marker = MarkerMotion()
        for k, u in enumerate(places[:-1]):
            marker.remember(u, 0.0, k, is_fresh=k == 0)
        speed, doubt = marker.speed(places[-1], 0)
        most = np.pi / 2 * np.abs(np.diff(places)[-3:]).max()
        assert abs(omega * np.cos(4 * omega + phase)) <= most * (1 + 1e-9)
        assert abs(speed) + doubt <= most * (1 + 1e-9)
        assert doubt > 0.0


def test_the_speed_of_a_marker_that_was_lost_is_that_of_its_way_until_it_was_lost_too_long():
    marker = cubic_motion(5)
    for lost, share in ((1, 0.5), (3, 0.25), (4, 0.0)):
        assert marker.speed(cubic(4) - 3.0, lost) == pytest.approx((-3.0 * share, 3.0 * share))


@pytest.mark.parametrize(
    ("changes", "n_markers", "found"),
    [
        ([0.3], 1, 0.0),  # one alone may be covered
        ([0.3, 0.1], 2, 0.1),
        ([0.3, -0.1], 2, 0.0),
        ([-0.3, -0.1], 2, -0.1),
        ([0.3, 0.0, 0.0], 3, 0.0),
        ([0.3, 0.2, -0.1], 3, 0.2),
        ([0.3, 0.2], 3, 0.2),
        ([0.3, 0.2], 4, 0.0),
        ([0.3, 0.2, 0.1, 0.0], 4, 0.1),
        ([], 3, 0.0),
    ],
)
def test_a_change_is_shared_as_far_as_most_markers_have_it(changes, n_markers, found):
    assert shared(changes, n_markers) == found
