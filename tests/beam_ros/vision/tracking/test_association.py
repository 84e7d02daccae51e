"""Which spot is the marker: hypotheses alone, and in films of twins and covers."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.rendering.disturbances import Disturbances, Occluder, SecondSpot
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.tracking.association import (
    Belief,
    Leap,
    Possible,
    Room,
    SpotPath,
    View,
    carried,
    moved_together,
)
from beam_ros.vision.tracking.tracker import MarkerTracker
from tests.beam_ros.vision.packaged_rig import packaged_camera, packaged_tracker


def view(frame, *columns, things=(), company=None, row_sd=0.1, **changes) -> View:
    """Return what a frame of 640 columns says of a marker in row 50, whose neighbours rest, or say where it is."""
    candidates = [
        column if isinstance(column, Possible) else Possible(float(column), 50.0) for column in columns
    ]
    fields = {
        "left": -np.inf,
        "right": np.inf,
        "width": 640.0,
        "row": 50.0,
        "row_sd": lambda _: row_sd,
        "row_reach": 5.0,
        "jump": lambda n: min(24.0 + 6.0 * (n - 1), 80.0),
        "diameter": 12.0,
        "stir": 0.0,
        "company": lambda _: company,
    }
    return View(frame, candidates, list(things), **{**fields, **changes})


def resting(u: float, n_frames: int = 20) -> SpotPath:
    """Return the way of a marker that rested in frames 0 to n - 1."""
    return SpotPath(tuple((k, u) for k in range(n_frames)), 50.0, 0.02, 0.02)


def odds(belief: Belief) -> float:
    return sum(np.exp(own.weight) for own in belief.hypotheses)


def test_a_spot_where_the_marker_should_be_is_the_marker_and_one_far_away_is_not():
    for away, index in ((0.0, 0), (5.0, 0), (60.0, None), (-250.0, None)):
        assert Belief().update(resting(300.0), view(20, 300.0 + away)) == index


def test_a_spot_is_believed_farther_away_the_longer_the_marker_was_lost():
    reach = []
    for lost in (1, 4, 12):
        near = [
            away
            for away in range(0, 200, 2)
            if Belief().update(resting(300.0), view(19 + lost, 300 + away)) == 0
        ]
        assert near == list(range(0, near[-1] + 2, 2))
        reach.append(near[-1])
    assert 10 < reach[0] < reach[1] < reach[2] <= 80


def test_two_spots_between_which_nothing_tells_are_neither_whatever_the_time():
    belief = Belief()
    belief.begin([SpotPath(((0, 300.0),), 50.0), SpotPath(((0, 340.0),), 50.0)])
    for k in range(1, 200):
        assert belief.update(None, view(k, 300.0, 340.0)) is None
    # Nor does it tell anything that one of them is gone.
    for k in range(200, 260):
        assert belief.update(None, view(k, 340.0)) is None
    assert odds(belief) == pytest.approx(1.0)


def test_the_weights_of_all_hypotheses_are_one_after_every_frame():
    rng, belief = np.random.default_rng(5), Belief()
    for k in range(20, 120):
        spots = rng.uniform(200.0, 400.0, rng.integers(0, 5))
        belief.update(resting(300.0) if k == 20 else None, view(k, *spots, things=rng.uniform(200, 400, 2)))
        assert odds(belief) == pytest.approx(1.0, abs=1e-4)
        assert len(belief.hypotheses) <= 16


def test_order_of_the_candidates_and_the_place_in_the_picture_change_nothing():
    found = []
    for shift, is_reversed in ((0.0, False), (37.0, False), (0.0, True)):
        belief, answers = Belief(), []
        for k in range(20, 60):
            spots = [300.0 + 8.0 * np.sin(0.3 * k) + shift, 330.0 + shift]
            j = belief.update(
                resting(300.0 + shift) if k == 20 else None, view(k, *spots[:: -1 if is_reversed else 1])
            )
            answers.append(1 - j if is_reversed and j is not None else j)
        found.append(answers)
    assert found[0] == found[1] == found[2]
    assert found[0].count(0) > 30


def test_of_two_that_met_and_part_the_one_is_the_marker_that_is_where_the_others_say():
    belief = Belief()
    belief.join(resting(300.0), 0.9)
    for k in range(20, 30):
        assert belief.update(None, view(k, things=[300.0], company=(300.0 + 2.0 * (k - 20), 0.5))) is None
    assert belief.update(None, view(30, 300.0, 322.0, company=(322.0, 0.5))) == 1
    assert len(belief.others) == 1


def test_what_comes_out_alone_where_two_were_is_neither():
    belief = Belief()
    belief.join(resting(300.0), 0.9)
    belief.update(None, view(20, things=[300.0]))
    for k in range(21, 40):
        belief.update(None, view(k))
    for k in range(40, 60):
        assert belief.update(None, view(k, 301.0)) is None


def test_a_spot_in_another_row_or_out_of_reach_of_the_beam_is_no_marker():
    path = resting(300.0)
    assert Belief().update(path, view(22, Possible(306.0, 50.0))) == 0
    assert Belief().update(path, view(22, Possible(306.0, 51.5))) is None
    assert Belief().update(path, view(22, Possible(306.0, 50.0), right=304.0)) is None


def test_another_light_is_believed_of_a_spot_that_moves_as_the_others_say_and_not_of_one_at_rest():
    for swing, is_believed in ((0.0, False), (9.0, True)):
        belief, answers = Belief(), []
        way = SpotPath(
            tuple((k, 300.0 + swing * np.sin(0.2 * k)) for k in range(25)), 50.0, 0.2 * swing, 0.04 * swing
        )
        for k in range(25, 45):
            u = 300.0 + swing * np.sin(0.2 * k)
            j = belief.update(
                way, view(k, Possible(u, 50.0, is_lit=False), company=(u, 0.05), stir=0.02 * swing)
            )
            answers.append(j is not None)
        assert any(answers) == is_believed
        assert answers == sorted(answers)


ROOM = Room(3, 213.0, 213.0, 8.0, 7.5, 1.7)


@pytest.mark.parametrize(
    ("found", "seen", "is_believed"),
    [
        # All markers in rows that moved together, by the same step or farther the higher they are.
        ({0: (40, 0), 1: (40, 0), 2: (45, 0)}, {}, True),
        ({0: (40, 8), 1: (60, 8), 2: (85, 9)}, {}, True),
        ({0: (40, 0), 1: (40, 12), 2: (40, -12)}, {}, False),
        # Most markers; beside one that rests, the beam bends.
        ({0: (40, 0), 1: (30, 0)}, {}, True),
        ({1: (70, 0), 2: (110, 0)}, {0: (1, 0)}, True),
        ({1: (110, 0), 2: (-70, 0)}, {0: (1, 0)}, False),
        # One alone only in company of those that are seen where they have moved alike.
        ({0: (40, 0)}, {}, False),
        ({0: (40, 0)}, {1: (0, 0), 2: (0, 0)}, False),
        ({0: (40, 0)}, {1: (35, 0)}, True),
        ({0: (40, 15)}, {1: (35, 0)}, False),
        ({}, {1: (35, 0)}, False),
    ],
)
def test_what_is_believed_of_three_markers_in_one_leap(found, seen, is_believed):
    moves = ({k: Leap(*move) for k, move in which.items()} for which in (found, seen))
    assert moved_together(*moves, ROOM) == is_believed


def test_a_single_marker_is_never_believed_to_have_leapt():
    assert not moved_together({0: Leap(100.0, 0.0)}, {}, Room(1, 213.0, 213.0, 8.0, 7.5, 1.7))


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
    u, doubt = carried(tip, [(low, 310.0), (middle, 190.0)], 20)
    assert u == pytest.approx(100.0 + 15.0 - 7.0, abs=0.5)
    assert abs(u - 108.0) < doubt < 3.0
    # Of a beam that rested nobody knows how it bends.
    still = [(k, 100.0) for k in frames]
    u, doubt = carried(still, [(still, 140.0)], 20)
    assert doubt > 2.0 * 40.0 / 3.0
    assert carried(still, [(still, 100.0)], 20)[1] < 0.7
    assert carried(still, [(still, 100.0), ([], 300.0)], 20) == carried(still, [(still, 100.0)], 20)
    assert carried(still[:3], [(still, 100.0)], 20) is None
    assert carried(still, [], 20) is None
