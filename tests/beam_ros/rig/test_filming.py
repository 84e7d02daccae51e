"""The simulated camera sees the plant where it is, averaged over its exposure."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.simulated.motion import Snapshots
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
