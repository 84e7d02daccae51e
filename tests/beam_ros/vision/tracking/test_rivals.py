"""Spots beside a marker that move at constant speed, whose places are known in every frame."""

from __future__ import annotations

import pytest

from beam_ros.vision.tracking.rivals import Track, associated, continued, present
from beam_ros.vision.tracking.spots import Spot

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
    assert [track.frame for track in tracks] == [4, 3]
    assert free == []


def test_a_rival_that_has_gone_while_the_marker_is_seen_is_remembered_for_ten_frames():
    gone = Track(100.0, 1.0, 20)
    assert continued([gone], [], 30, REACH) == [gone]
    assert continued([gone], [], 31, REACH) == []


@pytest.mark.parametrize(("u", "is_kept"), [(5.0, False), (15.0, True), (185.0, True), (195.0, False)])
def test_a_rival_last_seen_at_the_edge_of_what_is_looked_at_has_left(u, is_kept):
    track = Track(u, 0.0, 3)
    assert present([track], 4, 0.0, 200.0, REACH) == [track] * is_kept
    assert present([track], 3, 0.0, 200.0, REACH) == [track]  # it is in this very frame


def test_a_rival_last_seen_inside_is_remembered_for_a_hundred_frames():
    track = Track(100.0, 0.0, 3)
    assert present([track], 103, 0.0, 200.0, REACH) == [track]
    assert present([track], 104, 0.0, 200.0, REACH) == []
