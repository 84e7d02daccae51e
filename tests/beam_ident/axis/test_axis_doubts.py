"""What changes or limits the force of a record is named where forces outweigh the sensor's noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from beam_ident import TimeRecord, identify_axis
from beam_ident.axis.axis_doubts import of_jumps
from beam_ident.axis.axis_record import AxisRecord
from benchmarks.ident.driven_axis import DrivenAxis


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: np.where(np.arange(len(f)) < len(f) // 2, f, 0.8 * f), "halves of the record disagree"),
        (
            lambda f: np.clip(f, *(0.6 * np.array([np.min(f), np.max(f)]))),
            "stands at its largest or smallest",
        ),
        (lambda f: f + 0.02 * np.std(f) * np.random.default_rng(0).standard_normal(len(f)), ""),
    ],
    ids=["gain", "limit", "noise"],
)
def test_what_changes_the_force_is_named(change: Callable[[np.ndarray], np.ndarray], words: str) -> None:
    record = DrivenAxis(duration_s=8.0, noise=1e-6).record(1)
    drive = replace(record.input("force"), values=change(record.input("force").values))
    found = identify_axis(TimeRecord((drive,), record.outputs))
    assert found.method == "instrumental_variables"
    named = [warning for warning in found.warnings if "halves" in warning or "stands at" in warning]
    assert [words in warning for warning in named] == [True] * bool(words)


@pytest.mark.slow
def test_a_cable_beside_the_axis_is_named() -> None:
    record = DrivenAxis(duration_s=8.0).record(1)
    drive, (position,) = record.input("force"), record.outputs
    stiffness = 0.05 * np.std(drive.values) / np.std(position.values)
    pulled = replace(drive, values=drive.values + stiffness * position.values[: len(drive.values)])
    found = identify_axis(TimeRecord((pulled,), record.outputs))
    mass, sd = found.estimates[0], found.standard_deviations[0]
    # It takes k/omega^2 off the mass, of which the intervals know nothing.
    assert abs(mass - DrivenAxis().truth[0]) > 3.0 * sd
    assert any("go with the position" in warning for warning in found.warnings), found.warnings
    own = identify_axis(record, force="force")
    assert not any("go with" in warning for warning in own.warnings)


def one_wild(y: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(y)) == 4321, y + 0.02, y)


def lost(y: np.ndarray) -> np.ndarray:
    return np.where((np.arange(len(y)) >= 3000) & (np.arange(len(y)) < 3020), -0.05, y)


def wrapped(y: np.ndarray) -> np.ndarray:
    return np.mod(y, 0.05)


def slipped(y: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(y)) < 5000, y, y + 3e-3)


def jumps(axis: DrivenAxis, change: Callable[[np.ndarray], np.ndarray]) -> list[str]:
    record = axis.record(1)
    return of_jumps(
        [AxisRecord(record.inputs[0], replace(record.outputs[0], values=change(record.outputs[0].values)))]
    )


@pytest.mark.parametrize("change", [one_wild, lost, wrapped, slipped])
def test_positions_that_jump_as_no_axis_moves_are_named(change: Callable[[np.ndarray], np.ndarray]) -> None:
    assert "jumps by" in "".join(jumps(DrivenAxis(duration_s=8.0, noise=1e-6), change))


@pytest.mark.parametrize(
    "axis",
    [
        DrivenAxis(duration_s=8.0),
        DrivenAxis(duration_s=8.0, noise=1e-6, quantum=1e-4),
        DrivenAxis(duration_s=8.0, noise=1e-4),
        DrivenAxis(duration_s=8.0, static=15.0),
    ],
    ids=["plain", "coarse", "noisy", "sticking"],
)
def test_motion_steps_of_an_encoder_and_noise_are_no_jumps(axis: DrivenAxis) -> None:
    assert not jumps(axis, lambda y: y)


@pytest.mark.slow
def test_lost_samples_lead_no_simulation_to_infinity() -> None:
    # Inverse dynamics gave a friction that drives the axis; from there a simulation overflowed, in a LinAlgError.
    record = DrivenAxis(duration_s=8.0, noise=1e-6).record(1)
    output = replace(record.outputs[0], values=lost(record.outputs[0].values))
    found = identify_axis(replace(record, outputs=(output,)), force="force")
    assert any("jumps by" in warning for warning in found.warnings)
