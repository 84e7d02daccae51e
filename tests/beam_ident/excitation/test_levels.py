"""Binary sequences, pulses and doublets, in every quantity."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import Doublet, ExcitationError, Prbs, Pulse
from beam_ident.excitation.levels import levels_at, maximal_length_sequence


@pytest.mark.parametrize("order", range(3, 15))
def test_the_sequence_is_of_maximal_length(order):
    sequence = maximal_length_sequence(order)
    n = 2**order - 1
    assert len(sequence) == n
    assert np.sum(sequence) == 1.0  # one more +1 than -1
    # The autocorrelation of a maximal-length sequence is N at 0 and -1 elsewhere; a shorter one repeats.
    correlation = np.fft.irfft(np.abs(np.fft.rfft(sequence)) ** 2, n)
    np.testing.assert_allclose(correlation[1:], -1.0, atol=1e-6)


@pytest.mark.verify
@pytest.mark.parametrize("order", range(15, 19))
def test_long_sequences_are_of_maximal_length_too(order):
    sequence = maximal_length_sequence(order)
    correlation = np.fft.irfft(np.abs(np.fft.rfft(sequence)) ** 2, len(sequence))
    np.testing.assert_allclose(correlation[1:], -1.0, atol=1e-4)


def test_a_force_holds_the_levels_as_they_are():
    recipe = Prbs(drive="force", amplitude=2.0, order=5, clock_period=0.007, n_periods=2, still=0.1)
    held = recipe.sample_input(1e-3, unit="N")
    assert held.unit == "N"
    expected = np.repeat(np.tile(2.0 * maximal_length_sequence(5), 2), 7)
    np.testing.assert_array_equal(held.values[: len(expected)], expected)
    assert not np.any(held.values[len(expected) :])
    with pytest.raises(ExcitationError, match="use sample_input"):
        recipe.sample(1e-3)


def test_inverse_repetition_excites_odd_lines_alone():
    recipe = Prbs(drive="force", amplitude=1.0, order=6, clock_period=0.01, inverse_repeat=True, still=0.0)
    values = recipe.sample_input(0.01).values[:126]
    spectrum = np.abs(np.fft.rfft(values))
    assert np.max(spectrum[0::2]) < 1e-9
    assert np.min(spectrum[1:60:2]) > 1.0


def test_an_acceleration_sequence_stays_binary_but_for_what_brings_it_home():
    plain = Prbs(high_pass=0.0).sample()
    levels = np.abs(plain.accelerations[:10235])
    assert np.max(np.abs(levels - 0.3)) < 0.01
    near = Prbs(high_pass=1.0).sample()
    # The integral of a binary sequence wanders; without what is below 1 Hz it stays within millimetres.
    assert np.max(np.abs(near.positions)) < 0.003 < 0.02 < np.max(np.abs(plain.positions))
    change = np.abs(np.fft.rfft(near.accelerations - plain.accelerations))
    hz = np.fft.rfftfreq(len(near.accelerations), 1e-3)
    assert np.sum(change[hz > 3.0] ** 2) < 0.01 * np.sum(change**2)


def test_a_position_sequence_takes_its_levels_over_smooth_edges():
    recipe = Prbs(drive="position", amplitude=1e-4, order=5, clock_period=0.05, edge_time=0.02)
    excitation = recipe.sample()
    after = excitation.positions[25 + 5 : 31 * 50 : 50]  # in the middle of every level, past its edge
    np.testing.assert_allclose(np.abs(after), 1e-4, rtol=1e-9)
    # 35/16 and 7.513 are the peaks of the edge's first and second derivative.
    peaks = excitation.peaks()
    assert peaks["speed"][0] <= 2e-4 * 35 / 16 / 0.02 * 1.001
    assert peaks["acceleration"][0] == pytest.approx(2e-4 * 7.513 / 0.02**2, rel=0.03)  # twenty ticks


def test_velocity_levels_are_speeds():
    excitation = Prbs(drive="velocity", amplitude=0.01, order=8, clock_period=0.01, high_pass=0.0).sample()
    assert np.median(np.abs(excitation.velocities[5:2540])) == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize("rise", [0.0, 0.02])
def test_trains_of_pulses_return_by_their_own_shape(rise):
    """The correction that brings the axis home has nothing to do: levels stand as they were given."""
    velocity = Pulse(drive="velocity", amplitude=0.01, edge_time=rise, still=0.5).sample()
    acceleration = Pulse(drive="acceleration", amplitude=0.3, edge_time=rise, still=0.5).sample()
    doublet = Doublet(drive="acceleration", amplitude=0.3, edge_time=rise, still=0.5).sample()
    assert np.max(velocity.velocities) == pytest.approx(0.01, rel=1e-9)
    assert np.max(np.abs(velocity.velocities[220:300])) == pytest.approx(0.01, rel=1e-9)
    for excitation in (acceleration, doublet):
        assert np.max(excitation.accelerations) == pytest.approx(0.3, rel=1e-9)
        assert np.min(excitation.accelerations) == pytest.approx(-0.3, rel=1e-9)
    # Between the two halves of the doublet the axis rests where it went: amplitude * width^2.
    assert doublet.positions[700] == pytest.approx(0.3 * 0.1**2, rel=1e-9)
    assert doublet.velocities[700] == pytest.approx(0.0, abs=1e-12)


def test_a_position_pulse_goes_and_comes_back():
    excitation = Pulse(amplitude=-0.001, width=0.2, edge_time=0.05).sample()
    assert np.min(excitation.positions) == pytest.approx(-0.001, rel=1e-9)
    assert np.max(excitation.positions) < 1e-12
    np.testing.assert_allclose(excitation.positions[60:190], -0.001, rtol=1e-9)


def test_levels_switch_at_their_instants_in_spite_of_rounding():
    switches = 0.1 * np.arange(1, 6)
    ticks = np.arange(8) * 0.1  # 0.30000000000000004 among them
    values = levels_at(ticks, switches, np.array([1.0, -1.0, 2.0, -2.0, 0.0]), 0.0)
    np.testing.assert_array_equal(values, [0, 1, -1, 2, -2, 0, 0, 0])


def test_only_positions_have_a_displacement_without_a_period():
    assert Pulse().displacement(np.array([0.08]))[0] == pytest.approx(0.0005)
    with pytest.raises(ExcitationError, match=r"use sample\(period_s\).positions"):
        Pulse(drive="velocity").displacement(np.array([0.05]))


@pytest.mark.parametrize("kind", [Pulse, Doublet])
@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"width": 0.1, "edge_time": 0.2}, "at most width = 0.1"),
        ({"width": 0.0}, "width"),
        ({"gap": -0.1}, "gap"),
    ],
)
def test_pulses_of_both_kinds_are_no_shorter_than_their_edges(kind, fields, says):
    with pytest.raises(ExcitationError, match=says):
        kind(**fields)
    assert kind(width=0.05, edge_time=0.05).width == 0.05


def test_the_pause_is_each_kinds_own():
    assert (Pulse().gap, Doublet().gap) == (0.1, 1.0)


def test_an_acceleration_doublet_is_followed_by_its_mirror_image_after_the_gap():
    doublet = Doublet(drive="acceleration", amplitude=0.3, width=0.2, edge_time=0.05, gap=0.7)
    assert doublet.active_s == pytest.approx(0.45 + 0.7 + 0.45)
