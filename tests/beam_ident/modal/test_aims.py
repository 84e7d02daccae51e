"""Aims are read as they are written, and met when the stated standard deviation is small enough."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from beam_ident import Aim, EstimationError, ModalModel, aims_of
from beam_ident.modal.aims import most_to_go


def model() -> ModalModel:
    covariance = np.diag(np.square([0.01, 0.5, 1e-4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    return ModalModel(
        "base_motion",
        "hub",
        ("tip",),
        np.array([10.0, 100.0]),
        np.array([0.005, 0.01]),
        np.ones((1, 2)),
        np.zeros(1),
        np.ones(1),
        0.0,
        0.0,
        covariance,
        np.ones(1),
    )


def test_aims_are_read():
    found = aims_of("f1:0.01%, zeta2 : 2 %,f3:1e-5")
    assert [own.name for own in found] == ["f1", "zeta2", "f3"]
    assert [own.relative_sd for own in found] == pytest.approx([1e-4, 0.02, 1e-5])
    assert aims_of("zeta12:2%")[0].mode == 12


@pytest.mark.parametrize(
    "text", ["", "f1", "f0:1%", "q1:1%", "f1:1%;f2:1%", "f1:..%", "f1:1%,", "f1:1%, f1:2%", "f1:100%", "f1:0"]
)
def test_anything_else_is_refused(text):
    with pytest.raises(EstimationError, match="expected"):
        aims_of(text)


def test_the_stated_deviation_is_relative():
    assert Aim("f", 1, 0.1).relative_sd_of(model()) == pytest.approx(1e-3)
    assert Aim("f", 2, 0.1).relative_sd_of(model()) == pytest.approx(5e-3)
    assert Aim("zeta", 1, 0.1).relative_sd_of(model()) == pytest.approx(0.02)


def test_what_is_not_there_or_not_known_meets_no_aim():
    assert Aim("f", 3, 0.1).relative_sd_of(model()) == math.inf
    assert Aim("zeta", 2, 0.1).relative_sd_of(model()) == math.inf  # it states no deviation
    assert Aim("f", 3, 0.1).seconds_to_go(model(), 10.0) == math.inf


def test_half_the_deviation_takes_four_times_the_record():
    aim = Aim("f", 1, 0.5e-3)
    assert aim.seconds_to_go(model(), 10.0) == pytest.approx(30.0)
    longer = replace(model(), covariance=model().covariance / 4.0)
    assert aim.seconds_to_go(longer, 40.0) == pytest.approx(0.0, abs=1e-9)
    assert most_to_go((aim, Aim("zeta", 1, 0.01)), model(), 10.0) == pytest.approx(30.0)
