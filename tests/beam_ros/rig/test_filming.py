"""The simulated camera sees the plant where it is, averaged over its exposure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_model import BeamModel
from beam_ros.hub.parameters import AxisParameters
from beam_ros.hub.simulated.axis import VirtualAxis
from beam_ros.hub.simulated.motion import Snapshots
from beam_ros.hub.simulated.plant import RigidPlant
from beam_ros.rig.filming import Film
from beam_ros.rig.rig import Rig

START = 1_700_000_000_000_000_000


def _moving(rig: Rig, frequency_hz: float):
    """A hub that moves 1 mm at a frequency, the beam straight."""
    n_modes = rig.beam_model().n_modes

    def snapshots(stamps):
        times = np.asarray(stamps, dtype=np.int64)
        x = 1e-3 * np.sin(2 * np.pi * frequency_hz * (times - START) * 1e-9)
        zero = np.zeros(len(times))
        return Snapshots(times, x, zero, zero, np.zeros((len(times), n_modes)))

    return snapshots


def _rigid(snapshots: Snapshots) -> Snapshots:
    """The same of a beam of one mode that does not bend."""
    return replace(snapshots, coordinates=np.zeros((len(snapshots.times_ns), 1)))


def test_displacement_is_the_mean_over_the_exposure() -> None:
    """The mean of a sine over T is the sine at the middle times sinc(f T)."""
    rig = Rig.from_file()
    film = Film(rig, rig.beam_model(), _moving(rig, 80.0), START)
    exposures = list(film.due(START + 200_000_000))
    middles = np.array([film.marker_stamps(e)[0] for e in exposures])
    seen = np.array([film.mean_displacement(e)[0] for e in exposures])
    truth = 1e-3 * np.sinc(80.0 * 0.005) * np.sin(2 * np.pi * 80.0 * (middles - START) * 1e-9)
    assert len(exposures) == 20
    assert np.max(np.abs(seen - truth)) < 2e-10  # instants are whole nanoseconds: 0.5 m/s for half of one


def test_a_rolling_shutter_exposes_every_marker_at_its_own_time() -> None:
    rig = Rig.from_file().with_values({"camera.readout": 0.008, "camera.exposure": 0.002})
    film = Film(rig, rig.beam_model(), _moving(rig, 10.0), START)
    exposure = list(film.due(START + 100_000_000))[3]
    stamps = np.array(film.marker_stamps(exposure))
    assert np.all(np.diff(stamps) < 0)  # higher markers are higher in the image, read out earlier
    truth = 1e-3 * np.sinc(10.0 * 0.002) * np.sin(2 * np.pi * 10.0 * (stamps - START) * 1e-9)
    assert np.max(np.abs(film.mean_displacement(exposure) - truth)) < 2e-10


@pytest.mark.parametrize("readout", [0.0, 0.008])
def test_the_strip_is_where_the_markers_are_in_every_row(readout) -> None:
    """The beam of this test is straight, so that strip and markers move as one: each row at its own time."""
    rig = Rig.from_file().with_values({"camera.readout": readout, "camera.exposure": 0.002})
    film = Film(rig, rig.beam_model(), _moving(rig, 10.0), START)
    exposure = list(film.due(START + 100_000_000))[3]
    rows = film.camera.rows(film.strip_heights)
    stamps = np.array([film.timing.row_middle(exposure.stamp_ns, float(row)) for row in rows])
    truth = 1e-3 * np.sinc(10.0 * 0.002) * np.sin(2 * np.pi * 10.0 * (stamps - START) * 1e-9)
    # Straight lines over the 5.7 ms between two markers: a (5.7 ms)^2 / 8 at 4 m/s^2.
    assert np.max(np.abs(exposure.strip - truth)) < 2e-5


def test_nothing_is_shown_before_its_exposure_has_ended_and_nothing_twice() -> None:
    rig = Rig.from_file()
    film = Film(rig, rig.beam_model(), _moving(rig, 1.0), START)
    assert list(film.due(START + 4_999_999)) == []
    assert len(list(film.due(START + 5_000_000))) == 1
    assert list(film.due(START + 5_000_000)) == []


def test_a_camera_that_falls_far_behind_loses_frames_and_counts_them() -> None:
    rig = Rig.from_file()
    film = Film(rig, rig.beam_model(), _moving(rig, 1.0), START)
    shown = list(film.due(START + 3_000_000_000))
    assert len(shown) + film.dropped_frames == 300
    assert film.dropped_frames > 0


@pytest.mark.slow
def test_a_fast_camera_clock_shows_in_rate_and_stamps_and_not_in_what_is_seen() -> None:
    rig = Rig.from_file().with_values({"simulation.camera_clock_ppm": 500.0})
    film = Film(rig, rig.beam_model(), _moving(rig, 1.0), START)
    exposures, reached = [], START
    for _ in range(400):
        reached += 250_000_000
        exposures += film.due(reached)
    # 100 s at 100 frames a second of a clock that runs 500 ppm fast: five more frames, stamps 10 ms apart.
    assert len(exposures) == 10_005
    stamps = np.array([film.marker_stamps(e)[0] for e in exposures])
    assert set(np.diff(stamps)) == {10_000_000}
    true = (2_500_000 + (stamps - START - 2_500_000) / (1 + 500e-6)) * 1e-9
    seen = np.array([film.mean_displacement(e)[0] for e in exposures])
    expected = 1e-3 * np.sinc(0.005) * np.sin(2 * np.pi * true)
    assert np.max(np.abs(seen - expected)) < 2e-11  # a nanosecond at 6 mm/s


@pytest.mark.slow
def test_jitter_is_in_the_stamps_alone_and_lost_frames_are_those_that_the_file_asks_for() -> None:
    def film_of(**values: float) -> tuple[Film, dict[int, float]]:
        rig = Rig.from_file().with_values({f"simulation.{name}": value for name, value in values.items()})
        film = Film(rig, rig.beam_model(), _moving(rig, 10.0), START)
        seen = {}
        for k in range(1, 81):
            for exposure in film.due(START + k * 250_000_000):
                seen[exposure.stamp_ns] = film.mean_displacement(exposure)[0]
        return film, seen

    quiet, right = film_of()
    jittering, jittered = film_of(stamp_jitter=2e-4)
    errors = np.array(list(jittered)) - np.array(list(right))
    assert np.std(errors) == pytest.approx(2e5, rel=0.1)
    assert np.array_equal(list(jittered.values()), list(right.values()))
    dropping, kept = film_of(frame_drops=0.1)
    assert set(kept) < set(right)
    assert dropping.frames_left_out == len(right) - len(kept) == pytest.approx(200, abs=45)
    assert quiet.frames_left_out == jittering.frames_left_out == dropping.dropped_frames == 0
    assert film_of(frame_drops=0.1)[1] == kept
    assert film_of(frame_drops=0.1, seed=2)[1] != kept


def test_frames_that_the_plant_has_forgotten_while_others_were_drawn_are_lost_and_counted() -> None:
    """The emulator's plant runs on in a thread of its own, however slowly this computer draws."""
    rig = Rig.from_file()
    axis = VirtualAxis(AxisParameters(), RigidPlant(0.8, 1e-3))
    film = Film(rig, BeamModel(rig.beam_parameters(), 1), lambda stamps: _rigid(axis.snapshots(stamps)), 0)
    axis.advance(400_000_000)
    frames = film.due(400_000_000)
    next(frames)
    axis.advance(4_200_000_000)
    left = len(list(frames))
    # Of the 40 frames that were due those before 0.104 s are gone: so far back the plant knows.
    assert (left, film.dropped_frames) == (29, 10)


def test_stamps_that_are_late_at_this_start_are_late_in_the_stamps_alone() -> None:
    rig = Rig.from_file()
    late = rig.with_values({"simulation.stamp_offset": 0.4})
    films = [Film(one, one.beam_model(), _moving(one, 1.0), START) for one in (rig, late)]
    on_time, others = (list(film.due(START + 200_000_000)) for film in films)
    assert [b.stamp_ns - a.stamp_ns for a, b in zip(on_time, others, strict=True)] == [400_000_000] * len(
        on_time
    )
    assert np.array_equal(on_time[5].markers, others[5].markers)
