"""Spots beside a marker that move at constant speed, whose places are known in every frame."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.rendering.disturbances import Disturbances, Occluder, SecondSpot
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.rivals import (
    Course,
    Track,
    associated,
    carried,
    continued,
    left_over,
    may_be,
    on_course,
    present,
    recent,
    recognised,
    swinging,
    unseen,
)
from beam_ros.vision.tracking.spots import Spot
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker

REACH = 10.0


def spot(u: float) -> Spot:
    """Return a spot of which nothing but its column matters."""
    return Spot(u, 50.0, 9e4, 450.0, 36.0, 36.0, 0.0, 0.0, 0.0, 200.0, (0, 0, 1, 1))


def test_a_spot_seen_once_stands_still_and_one_seen_twice_goes_on_as_it_went():
    tracks = continued([], [spot(100.0)], 7, REACH)
    assert tracks == [Track(100.0, 0.0, 7)]
    assert tracks[0].predicted(9) == 100.0
    tracks = continued(tracks, [spot(106.0)], 10, REACH)
    assert tracks == [Track(106.0, 2.0, 10)]  # 6 px in 3 frames
    assert [tracks[0].predicted(frame) for frame in (10, 11, 15)] == [106.0, 108.0, 116.0]


def test_tracks_that_cross_keep_their_ways():
    # Between two frames they pass each other: nearer to each one's last place is the other.
    right, left = Track(100.0, 8.0, 3), Track(110.0, -8.0, 3)
    tracks, free = associated([right, left], [spot(102.5), spot(107.5)], 4, REACH)
    assert [track.u for track in tracks] == [107.5, 102.5]
    assert [track.velocity for track in tracks] == [7.5, -7.5]
    assert free == []


def test_a_spot_belongs_to_a_track_within_reach_and_to_none_beyond():
    track = Track(100.0, 2.0, 3)
    near, far = spot(102.0 - REACH), spot(102.0 - REACH - 1e-6)
    assert associated([track], [near], 4, REACH) == ([Track(near.u, near.u - 100.0, 4)], [])
    assert associated([track], [far], 4, REACH) == ([track], [far])
    assert associated([track], [], 4, REACH) == ([track], [])


def test_a_spot_looked_at_twice_in_one_frame_keeps_its_velocity():
    tracks, free = associated([Track(100.0, 2.0, 4)], [spot(100.0)], 4, REACH)
    assert tracks == [Track(100.0, 2.0, 4)]
    assert free == []


def test_one_spot_continues_one_track():
    tracks, free = associated([Track(100.0, 0.0, 3), Track(101.0, 0.0, 3)], [spot(100.6)], 4, REACH)
    assert [track.frame for track in tracks] == [3, 4]  # the nearer one
    assert free == []


def test_a_rival_that_has_gone_while_the_marker_is_seen_is_remembered_and_predicted_for_ten_frames_only():
    gone = Track(100.0, 1.0, 20)
    assert continued([gone], [], 120, REACH) == [gone]
    assert continued([gone], [], 121, REACH) == []
    assert recent([gone], 30) == [gone]
    assert recent([gone], 31) == []


@pytest.mark.parametrize(("u", "is_kept"), [(5.0, False), (15.0, True), (185.0, True), (195.0, False)])
def test_a_rival_last_seen_at_the_edge_of_what_is_looked_at_has_left(u, is_kept):
    track = Track(u, 0.0, 3)
    assert present([track], 4, 0.0, 200.0, REACH) == [track] * is_kept
    assert present([track], 3, 0.0, 200.0, REACH) == [track]  # it is in this very frame


def test_a_rival_last_seen_inside_is_remembered_for_a_hundred_frames():
    track = Track(100.0, 0.0, 3)
    assert present([track], 103, 0.0, 200.0, REACH) == [track]
    assert present([track], 104, 0.0, 200.0, REACH) == []


@pytest.mark.parametrize("u", [5.0, 195.0])
def test_a_rival_that_vanished_inside_stays_hidden_where_the_columns_looked_at_move_on_past_it(u):
    track = Track(u, 0.0, 3)
    assert present([track], 5, 0.0, 200.0, REACH) == [track]


def test_a_hidden_rival_is_continued_by_the_one_spot_that_only_it_can_be():
    hidden, other, mine = Track(100.0, -4.0, 3), spot(95.0), spot(108.0)
    assert unseen([hidden, Track(50.0, 0.0, 9)], 10) == [hidden]
    assert recognised([hidden], [other, mine], [mine], 10, 7.0) == ([Track(95.0, 0.0, 10)], [mine])
    # Both are in its reach, or the only one may be the marker: neither is known.
    for spots in ([other, mine], [mine]):
        tracks, free = recognised([hidden], spots, [mine], 10, 9.0)
        assert (tracks, free) == ([hidden], spots)
        assert may_be(tracks, mine, 10, 9.0)
    assert not may_be([hidden], spot(110.0), 10, 9.0)


def test_a_course_is_a_straight_way_known_less_well_the_longer_ago_and_the_more_it_scatters():
    places = [(3, 10.0), (4, 12.1), (5, 13.9), (6, 16.0)]
    assert Course.of(Track(16.0, 2.0, 6, tuple(places[1:3]))) is None  # three places
    course = Course.of(Track(16.0, 2.0, 6, tuple(places[:3])))
    slope, start = np.polyfit([0, 1, 2, 3], [u for _, u in places], 1)
    assert course.predicted(16) == pytest.approx(start + 13 * slope)
    scatter = float(np.std([u - start - slope * k for k, (_, u) in enumerate(places)]))
    assert course.doubt(6) == pytest.approx(0.3 + 4 * scatter)
    assert course.doubt(12) == pytest.approx(0.3 + 4 * scatter * 17)  # twice as long unseen as seen


def test_what_is_left_over_is_no_rival_only_where_every_rival_is_seen_where_it_was_bound_for():
    courses = [Course(100.0, 0.0, 5, 5, 0.0), Course(150.0, -2.0, 5, 5, 0.0)]  # at 100 and 140 in frame 10
    first, second, mine = spot(100.2), spot(139.9), spot(120.0)
    assert left_over(courses, [first, mine, second], 10) == mine
    assert left_over(courses, [first, mine], 10) is None  # one is hidden
    assert left_over(courses, [first, mine, second, spot(200.0)], 10) is None  # who is the fourth?
    assert left_over(courses, [spot(100.4), mine, second], 10) is None  # a rival is not where it should be
    assert left_over(courses, [first, spot(140.8), second], 10) is None  # too near to a rival's way
    assert left_over(courses, [first, mine, spot(160.0)], 10) is None
    assert on_course([first, mine], 100.0, 0.3) == first
    assert on_course([first, spot(100.8)], 100.0, 0.3) is None


def swing(frame: int) -> float:
    return 8.0 * np.sin(0.25 * frame)


def track(way, last: int = 20, first: int = 0) -> Track:
    """Return a track of a spot that was at way(frame) in the frames up to the last."""
    return Track(way(last), 0.0, last, tuple((k, way(k)) for k in range(first, last)))


COMPANY = [(k, 300.0 + 1.4 * swing(k)) for k in range(20)]


def test_of_a_spot_that_moves_as_the_beam_and_one_that_does_not_the_first_is_on_the_beam():
    mine = track(lambda k: 100.0 + swing(k))
    for other in (track(lambda k: 160.0), track(lambda k: 160.0 + 1.5 * k)):
        assert swinging([other, mine], [COMPANY], 20) is mine
        assert (
            swinging([mine, other, Track(50.0, 0.0, 15)], [COMPANY], 20) is mine
        )  # one more, hidden long ago
        assert swinging([mine, other], [COMPANY[:10]], 20) is None  # nobody shows what the beam does
        assert swinging([mine, other], [[(k, -u) for k, u in COMPANY]], 20) is None  # the other way
        assert swinging([mine], [COMPANY], 20) is None
    rest = track(lambda k: 160.0)
    assert swinging([track(lambda k: 100.0 + swing(k), first=9), rest], [COMPANY], 20) is None  # too short
    assert swinging([mine, track(lambda k: 140.0 + swing(k))], [COMPANY], 20) is None  # both do
    assert swinging([rest, track(lambda k: 100.0 + 2.0 * k)], [COMPANY], 20) is None  # none does
    assert swinging([mine, track(lambda k: 101.0)], [COMPANY], 20) is None  # they may have been exchanged


HEIGHTS = (0.010, 0.225, 0.285)


def followed(
    x_px, twin_px, cover_px, n_frames: int, grey: float = 20.0, twin_below: float = 0.0
) -> list[float]:
    """Errors of the middle marker where it is valid [px]; x, twin and cover's two edges are given by frame."""
    camera = packaged_camera(noise_grey=1.0)
    renderer, tracker = (
        SceneRenderer(camera, HEIGHTS),
        MarkerTracker(packaged_tracker(camera, HEIGHTS, max_bend_px=90.0), 3),
    )
    rng, row = np.random.default_rng(61), float(camera.rows(HEIGHTS[1]))
    instants = np.polynomial.legendre.leggauss(renderer.sub_instants)[0]
    errors = []
    for k in range(n_frames):
        at, cover = twin_px(k), cover_px(k)
        disturbances = Disturbances(
            spots=() if at is None else (SecondSpot(320.0 + at, row + twin_below),),
            occluders=()
            if cover is None
            else (Occluder(320.0 + cover[0], row - 30, 320.0 + cover[1], row + 30, grey),),
        )
        way = np.array([x_px(k + instant / 4) for instant in instants])  # half of the time between two frames
        frame = renderer.render(np.repeat(way[:, None], 3, axis=1) / 1500, rng, disturbances=disturbances)
        marker = tracker.process(frame, k).markers[1]
        if marker.is_valid:
            errors.append(marker.u_px - float(camera.columns(renderer.exposure_weights @ way / 1500)))
    return errors


@pytest.mark.slow
def test_a_twin_beside_which_the_marker_is_found_is_not_taken_for_it_once_that_is_covered():
    # The two rest beside each other for forty frames, and nobody can tell which is the marker: then one is covered.
    errors = followed(lambda k: 0.0, lambda k: 21.7, lambda k: (-70.0, -6.2 + 0.5 * max(0, k - 40)), 70)
    assert errors == []


def test_a_twin_is_not_taken_for_the_marker_that_was_covered_beside_it_and_swings_past_it():
    # Where the marker vanished is soon farther from the others than the beam bends, and the twin comes out first.
    errors = followed(
        lambda k: min(max(-39.0, 5.0 * (k - 16) - 39.0), 30.0),
        lambda k: 0.0,
        lambda k: None if k < 12 else (-60.0, 20.0 + 2.0 * (k - 12)) if k < 34 else (10.0, 64.0),
        42,
    )
    assert errors == []


def test_a_twin_that_has_left_the_picture_leaves_the_marker_to_be_found_at_once():
    errors = followed(lambda k: 0.0, lambda k: 40.0 + 5 * k, lambda k: None, 20)
    # Farther than the beam bends from the other markers (90 px), or by a jump (24 px) less, it has gone.
    assert len(errors) >= 8
    assert np.abs(errors).max() < 0.05


@pytest.mark.parametrize("apart", [15.7, 16.0, 16.3])
def test_a_marker_that_met_a_twin_is_not_taken_for_what_remains_while_the_other_is_touched(apart):
    # At this distance the twin is alone in its surroundings already, the marker's touch the twin.
    x = [1.25, 2.65, 3.85, 6.15, 10.05, 13.75, apart + 0.25, 18.0, 20.5]
    errors = followed(
        lambda k: float(np.interp(k - 24, range(9), x)),
        lambda k: 0.25 if k >= 26 else None,
        lambda k: None,
        36,
    )
    assert len(errors) >= 26
    assert np.abs(errors).max() < 0.05


def test_a_twin_that_was_covered_with_the_marker_and_comes_first_is_not_taken_for_it():
    def x(k):
        return 10.0 - 4.0 * max(0, k - 30) if k < 36 else -14.0 + 2.0 * (k - 36)

    errors = followed(
        x,
        lambda k: x(k) - 30.0 if k >= 20 else None,
        lambda k: (-80.0, 80.0) if 34 <= k < 46 else (x(46) - 14.0, 80.0) if 46 <= k < 54 else None,
        60,
    )
    assert len(errors) >= 34
    assert np.abs(errors).max() < 0.05


def test_a_twin_that_touched_the_marker_before_both_were_covered_is_not_taken_for_it():
    # The marker moves on by 20 px under the cover, and the twin, which rests, comes out first.
    errors = followed(
        lambda k: 0.0 if k < 42 else min(2.0 * (k - 42), 20.0),
        lambda k: 4.0 if k >= 30 else None,
        lambda k: (-60.0, 60.0) if 38 <= k < 54 else (12.0, 60.0) if 54 <= k < 60 else None,
        64,
    )
    assert len(errors) >= 30
    assert np.abs(errors).max() < 0.05


def test_a_twin_that_was_covered_long_before_the_marker_and_comes_first_is_not_taken_for_it():
    errors = followed(
        lambda k: 0.0,
        lambda k: -24.0 if k >= 20 else None,
        lambda k: (
            (-60.0, min(-12.0 + 2.0 * max(0, k - 44), 30.0))
            if 30 <= k < 66
            else (-10.0, 30.0)
            if k >= 66
            else None
        ),
        72,
        grey=120.0,
    )
    assert len(errors) >= 44
    assert np.abs(errors).max() < 0.05


def test_a_twin_that_has_just_come_is_not_taken_for_the_marker_that_nears_it():
    # It came after the last look for rivals; their surroundings overlap in one frame and not in the next.
    x = [14.17, 14.43, 14.22, 13.58, 12.49, 10.97, 9.115, 6.985, 4.61, 2.07, -0.51, -3.06]
    errors = followed(
        lambda k: float(np.interp(k - 31, range(12), x)),
        lambda k: -14.14 if k >= 31 else None,
        lambda k: None,
        43,
    )
    assert len(errors) >= 38
    assert np.abs(errors).max() < 0.05


@pytest.mark.first_case
@pytest.mark.parametrize("apart", [12.7, -12.7, 14.0])
def test_a_twin_that_touched_the_marker_from_the_first_frame_on_is_not_found_for_it_once_that_is_covered(
    apart,
):
    def cover(k):
        edge = 14.0 - 2.5 * (k - 12)  # of a bar that comes from the marker's far side
        return None if k < 12 else (-40.0, -edge) if apart > 0 else (edge, 40.0)

    assert followed(lambda k: 0.0, lambda k: apart, cover, 24, grey=0.0) == []


def test_a_twin_is_not_taken_for_the_marker_that_it_met_and_that_is_hidden_while_the_twin_is_far():
    errors = followed(
        lambda k: 0.0,
        lambda k: -76.0 * np.sin(0.1 * (k - 42.3)) if k >= 40 else None,  # farthest in frame 58
        lambda k: (-20.0, 20.0) if 56 <= k < 65 else None,
        70,
    )
    assert len(errors) >= 36
    assert np.abs(errors).max() < 0.1


@pytest.mark.parametrize("speed", [-16.0, 12.0])
def test_a_twin_is_not_taken_for_the_marker_that_it_met_where_the_beam_moves_away(speed):
    # The beam as a whole goes farther than a lost marker is looked for, which says nothing about whom to believe.
    errors = followed(
        lambda k: speed * max(0, k - 30),
        lambda k: speed * 5.5 - np.sign(speed) * 8.0 * (k - 35.5) if k >= 31 else None,
        lambda k: None,
        48,
    )
    assert len(errors) >= 30
    assert np.abs(errors).max() < 0.1


def test_a_twin_is_not_taken_for_the_marker_with_which_it_was_lost_and_came_back_in_one_frame():
    # Both are seen apart in frame 43 for the first time since they touched; then the marker leaves the picture.
    errors = followed(
        lambda k: -22.9 * max(0.0, np.floor(k + 0.5) - 30),
        lambda k: -338.6 + 6.58 * (k - 30),
        lambda k: None,
        48,
    )
    assert len(errors) >= 40
    assert np.abs(errors).max() < 0.1


@pytest.mark.slow
def test_a_marker_that_passed_a_twin_at_rest_is_told_from_it_within_three_frames():
    errors = followed(
        lambda k: 25.0 * np.sin(0.15 * (k - 20)),
        lambda k: 0.0 if k >= 28 else None,  # apart first; their surroundings overlap in frames 37 to 45
        lambda k: None,
        52,
    )
    assert np.abs(errors).max() < 0.1
    assert len(errors) >= 40


@pytest.mark.parametrize("below", [-1.0, 0.7, 3.0])
def test_a_marker_that_met_a_twin_in_another_row_is_known_by_its_row_once_they_are_apart(below):
    # The twin appears where it touches, and stays near; apart by a diameter and more from frame 40 on.
    errors = followed(
        lambda k: 9.0 * max(0.0, min(1.0, (k - 36) / 4)),
        lambda k: -9.0 if k >= 30 else None,
        lambda k: None,
        60,
        twin_below=below,
    )
    assert len(errors) >= 48
    assert np.abs(errors).max() < 0.1


def test_a_twin_in_another_row_is_not_taken_for_a_marker_that_is_covered():
    errors = followed(
        lambda k: 0.0,
        lambda k: 20.0 if k >= 34 else None,
        lambda k: (-60.0, 8.0) if k >= 32 else None,
        60,
        twin_below=1.0,
    )
    assert len(errors) == 32
    assert np.abs(errors).max() < 0.1


@pytest.mark.slow
def test_a_marker_that_swings_beside_a_twin_at_rest_from_the_first_frame_on_is_acquired_by_its_motion():
    errors = followed(lambda k: 20.0 * np.sin(0.2 * k), lambda k: 60.0, lambda k: None, 40)
    assert len(errors) >= 24
    assert np.abs(errors).max() < 0.1


def test_a_twin_that_appears_beside_a_marker_costs_no_frame():
    errors = followed(
        lambda k: 20.0 * np.sin(0.1 * k), lambda k: 40.0 if k in (20, 21) else None, lambda k: None, 30
    )
    assert len(errors) == 30
    errors = followed(lambda k: 0.5 * k, lambda k: 17.0 + 0.5 * k if k >= 20 else None, lambda k: None, 40)
    assert len(errors) >= 38
    assert np.abs(errors).max() < 0.1


def test_a_dim_bar_that_passes_over_a_marker_is_no_twin_that_touched_it():
    errors = followed(lambda k: 0.0, lambda k: None, lambda k: (-90.0 + 4 * k, -60.0 + 4 * k), 60, grey=60.0)
    # The bar covers the marker from frame 13 to 25, and is within its surroundings for some frames before and after.
    assert len(errors) >= 40
    assert np.abs(errors).max() < 0.2


def test_the_others_tell_where_a_marker_is_and_how_well():
    frames = range(20)
    low, middle = (
        [(k, 300.0 + 3.0 * np.sin(0.5 * k)) for k in frames],
        [(k, 200.0 + 8.0 * np.cos(0.3 * k)) for k in frames],
    )
    tip = [
        (k, 100.0 + 1.5 * (a - 300.0) + 0.7 * (b - 200.0)) for (k, a), (_, b) in zip(low, middle, strict=True)
    ]
    u, doubt = carried(tip, [(low, 310.0), (middle, 190.0)])
    assert u == pytest.approx(100.0 + 15.0 - 7.0, abs=0.5)
    assert abs(u - 108.0) < doubt < 8.0
    # Of a beam that rested nobody knows how it bends.
    still = [(k, 100.0) for k in frames]
    u, doubt = carried(still, [(still, 140.0)])
    assert doubt > 2.0 * 40.0
    assert carried(still, [(still, 100.0)])[1] < 2.0
    assert carried(still, [(still, 100.0), ([], 300.0)]) == carried(still, [(still, 100.0)])
    assert carried(still[:3], [(still, 100.0)]) is None
    assert carried(still, []) is None
