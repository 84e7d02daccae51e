"""The drawn beam: measured and predicted at one instant, and the traces of the last seconds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beam_ros.hub.contract import SampleBatch
from beam_ros.messages import Displacement
from beam_ros.rig.rig import Rig
from beam_ros.view.drawn_beam import DrawnBeam

START = 1_700_000_000_000_000_000
NAMES = ("z010", "z225", "z285")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig.from_file()


def batch(first_ms: int, positions: np.ndarray) -> SampleBatch:
    return SampleBatch(START + first_ms * 1_000_000, 1_000_000, 1, positions=positions)


def test_markers_of_a_mode_shape_draw_this_shape(rig):
    beam, model = DrawnBeam(rig), rig.beam_model()
    heights = np.array(rig.markers.heights)
    first = model.shape(heights)[:, 0] / model.shape([rig.beam.length])[0, 0]
    beam.add_markers(Displacement(START, NAMES, 0.002 + 0.01 * first))
    shape = beam.shape()
    expected = 2.0 + 10.0 * model.shape(np.array(shape["heights"]) * 1e-3)[:, 0] / model.shape([0.3])[0, 0]
    # Three markers tell of four unknowns (hub and modes): the prior takes a share of less than 1 % of the bending.
    np.testing.assert_allclose(shape["measured"], expected, atol=0.1)
    assert beam.tip.since(-1, 0)["rows"][-1][1] == pytest.approx(10.0, abs=0.1)


def test_hub_and_prediction_are_those_of_the_frames_instant(rig):
    beam = DrawnBeam(rig)
    ticks = np.arange(200)
    beam.add_hub(batch(0, 1e-5 * ticks))
    beam.add_markers(Displacement(START + 100_500_000, NAMES, np.zeros(3)))
    assert beam.shape()["hub"] == pytest.approx(1.005)  # half way between ticks 100 and 101
    assert beam.shape()["predicted"][0] == pytest.approx(1.005)
    assert beam.speed == pytest.approx(1e-5 / 1e-3)


def test_what_is_not_seen_is_null_and_never_a_number(rig):
    beam = DrawnBeam(rig)
    empty = beam.shape()
    assert empty["measured"] is None
    assert empty["predicted"] is None
    assert empty["hub"] is None
    assert empty["markers"] == [None, None, None]
    beam.add_markers(Displacement(START, NAMES, np.array([1e-3, math.nan, 1e-3])))
    assert beam.shape()["markers"] == [1.0, None, 1.0]
    assert all(math.isfinite(value) for value in beam.shape()["measured"])
    beam.add_markers(Displacement(START + 10_000_000, ("x", "y", "z"), np.zeros(3)))
    assert beam.shape()["markers"] == [None, None, None]
    assert beam.tip.since(-1, 0)["rows"][-1][1] is None


def test_a_frame_that_comes_in_pieces_is_one_frame(rig):
    beam = DrawnBeam(rig)
    for k, name in enumerate(NAMES):
        beam.add_markers(Displacement(START, (name,), np.array([1e-3 * (k + 1)])))
    assert beam.shape()["markers"] == [1.0, 2.0, 3.0]


def test_stamps_that_step_back_begin_the_curves_anew_and_say_by_how_much(rig):
    beam = DrawnBeam(rig)
    beam.add_hub(batch(10_000, np.zeros(20)))
    epoch = beam.hub.epoch
    beam.add_hub(batch(7_000, np.zeros(20)))
    assert beam.stepped_back_s == pytest.approx(3.019)
    assert beam.hub.epoch == epoch + 1
    assert beam.hub.since(-1, 0)["rows"][0][0] == pytest.approx(-3.0)


def test_theory_has_the_clamped_modes_of_the_rig_file() -> None:
    theory = DrawnBeam(Rig.from_file()).theory()
    assert theory["frequency_hz"][:3] == pytest.approx([4.384, 28.262, 79.358], abs=5e-4)
    shapes = np.array(theory["shapes"])
    assert np.abs(shapes).max(axis=1) == pytest.approx(np.ones(len(shapes)))
    crossings = np.count_nonzero(np.diff(np.sign(shapes[:, 1:]), axis=1), axis=1)
    assert crossings.tolist() == list(
        range(len(shapes))
    )  # a clamped beam's mode k has k - 1 nodes above the clamp
    assert theory["heights"][-1] == pytest.approx(300.0)
