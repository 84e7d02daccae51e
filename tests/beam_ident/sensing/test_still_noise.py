"""Noise of an input that nobody declared: found in rest, and nowhere else."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from beam_ident import InputSignal, LogChirp, TimeRecord, estimate_transfer_function, identify
from beam_ident.sensing.still_noise import StillNoise, counted_input_warning
from benchmarks.ident.rig import Rig
from tests.beam_ident.truth import OMEGAS, beam_record

CHIRP = LogChirp(duration=10.0, still=3.0).sample(1e-3)


def measured(sigma: float, quantum: float = 0.0, seed: int = 0) -> InputSignal:
    drive = CHIRP.input_signal("position", "hub")
    values = drive.values + sigma * np.random.default_rng(seed).standard_normal(len(drive.values))
    if quantum:
        values = quantum * np.round(values / quantum)
    return dataclasses.replace(drive, values=values)


@pytest.mark.parametrize("sigma", [5e-8, 5e-7, 1e-5])
def test_the_noise_of_rest_is_found_to_a_tenth(sigma):
    found = [StillNoise.of(measured(sigma, seed=seed)).sigma for seed in range(5)]
    np.testing.assert_allclose(found, sigma, rtol=0.1)


def test_a_quiet_encoder_has_the_noise_of_its_steps():
    assert StillNoise.of(measured(0.0, 1e-6)).sigma == pytest.approx(1e-6 / np.sqrt(12.0), rel=0.01)


@pytest.mark.parametrize(("sigma", "quantum"), [(5e-8, 0.0), (5e-7, 0.0), (0.0, 1e-6)])
def test_noise_beneath_a_motion_that_never_rests_is_the_floor_of_its_spectrum(sigma, quantum):
    inside = slice(1000, 9000)
    found = []
    for seed in range(5):
        drive = measured(sigma, quantum, seed)
        drive = InputSignal("hub", "m", (0.0, 1e-3), drive.values[inside], "cubic")
        noise = StillNoise.of(drive)
        assert noise.still_s == 0.0
        found.append(noise.sigma)
    np.testing.assert_allclose(found, sigma or quantum / np.sqrt(12.0), rtol=0.1)


def test_what_has_no_noise_of_a_sensor_gets_none():
    rng = np.random.default_rng(1)
    n = 8000
    rough = rng.standard_normal(n)
    burst = np.where(np.arange(n) < n // 2, rough, 0.0)
    for values, hold in (
        (CHIRP.positions, "cubic"),
        (CHIRP.positions[1000:9000], "cubic"),
        (np.cumsum(rough), "cubic"),
        (np.cumsum(np.cumsum(rough)), "cubic"),
        (np.repeat(np.sign(rough[: n // 40]), 40), "linear"),
        (np.repeat(np.sign(rough[: n // 40]), 40) * np.sin(0.01 * np.arange(n)), "linear"),
        (rough, "linear"),
        (burst, "linear"),
        (np.sin(0.05 * np.arange(n)), "cubic"),
        (np.where(np.arange(n) > 500, 1.0, 0.0), "linear"),
        (CHIRP.positions + 1e-6 * rng.standard_normal(len(CHIRP.positions)), "zoh"),
    ):
        assert StillNoise.of(InputSignal("u", "", (0.0, 1e-3), values, hold)).sigma == 0.0


def stepped(kind: str) -> np.ndarray:
    """Return 12 s of a command that is held between its steps of 0.3."""
    rng = np.random.default_rng(0)
    anyhow = np.cumsum(np.diff(rng.integers(-12, 13, 201)))
    if kind == "staircase":
        return 0.3 * np.repeat(np.cumsum(np.where(np.arange(200) % 80 < 40, 1, -1)), 60)
    return 0.3 * np.repeat(anyhow, 60 if kind == "levels" else rng.integers(40, 80, 200))


@pytest.mark.parametrize("hold", ["linear", "cubic"])
@pytest.mark.parametrize("kind", ["staircase", "levels", "levels for any time"])
def test_the_levels_of_a_stepped_input_are_no_counts_of_an_encoder(kind, hold):
    assert StillNoise.of(InputSignal("u", "N", (0.0, 1e-3), stepped(kind), hold)).sigma == 0.0


def test_a_slow_motion_that_is_counted_has_the_noise_of_its_counts():
    n = len(CHIRP.positions)
    slow = np.interp(np.arange(0.0, n, 0.05), np.arange(n), CHIRP.positions)
    step = 2.0 * np.max(np.abs(np.diff(slow)))
    counted = InputSignal("hub", "m", (0.0, 1e-3), step * np.round(slow / step), "cubic")
    assert StillNoise.of(counted).sigma == pytest.approx(step / np.sqrt(12.0), rel=0.01)


def undeclared(record: TimeRecord) -> TimeRecord:
    return dataclasses.replace(record, inputs=(dataclasses.replace(record.inputs[0], sigma=0.0),))


@pytest.mark.slow
@pytest.mark.parametrize("is_cut", [False, True])
def test_half_a_micrometre_that_nobody_declared_is_weighed_as_if_it_were(is_cut):
    rig = Rig()
    record = rig.record(2, encoder_sd=5e-7)
    n_modes = 2 if is_cut else 3
    if is_cut:  # to what never rests
        seconds = record.inputs[0].times_s
        record = record.between(0.08 * seconds[-1], 0.62 * seconds[-1])
    stated, found = identify(record, n_modes=n_modes), identify(undeclared(record), n_modes=n_modes)
    (said,) = [said for said in found.warnings if "that nobody declared: 5" in said]
    assert ("flat end of its spectrum" in said) == is_cut
    assert not any("declared" in said for said in stated.warnings)
    moved = found.model.natural_frequencies - stated.model.natural_frequencies
    assert np.max(np.abs(moved) / stated.model.natural_frequency_sd) < 0.5
    errors = found.model.natural_frequencies - rig.truth[:n_modes]
    assert np.max(np.abs(errors) / found.model.natural_frequency_sd) < 3.3


@pytest.mark.slow
def test_an_estimator_that_does_not_weigh_it_says_so():
    record = undeclared(Rig().record(2, encoder_sd=2e-6)).select(["z285"])
    found = estimate_transfer_function(record, 4, 4, n_starts=1)
    assert any("that nobody declared: 2e-06 m" in said and "identify()" in said for said in found.warnings)


def test_a_motion_by_few_counts_is_named():
    said = counted_input_warning(measured(0.0, 5e-6))
    assert re.match(
        r"Rounding: hub is counted in steps of 5e-06 m, and for [12]\.\d+ s it moves by less than 4", said
    )


def test_counts_that_no_motion_follows_or_that_noise_dithers_are_not():
    dithered, fine = measured(2.5e-6, 5e-6), measured(0.0, 1e-9)
    command = dataclasses.replace(measured(0.0, 5e-6), hold="zoh")
    at_rest = dataclasses.replace(fine, values=np.where(np.arange(len(fine.values)) > 500, 5e-6, 0.0))
    for drive in (dithered, command, measured(5e-7), at_rest):
        assert not counted_input_warning(drive)


@pytest.mark.slow
def test_a_hub_of_coarse_steps_is_named_and_feigns_no_mode():
    """The third mode is passed in a step and a half: modes that take its place are in doubt once the noise weighs."""
    record = beam_record(3, LogChirp(), encoder=0.0)
    (drive,) = record.inputs
    counted = dataclasses.replace(drive, values=1e-5 * np.round(drive.values / 1e-5))
    found = identify(dataclasses.replace(record, inputs=(counted,)))
    assert found.converged
    assert found.doubts == ("", "")
    errors = found.model.natural_frequencies / OMEGAS[:2] - 1.0
    assert np.max(np.abs(errors) / found.model.natural_frequency_sd * found.model.natural_frequencies) < 4.0
    assert any(said.startswith("Rounding: hub is counted") for said in found.warnings)
