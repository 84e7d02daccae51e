"""A free base that rolls with friction: seen where the structure has none, and estimated where it has."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, LogChirp, TimeRecord, identify
from benchmarks.ident.forced_hub import FreeHubCase
from benchmarks.ident.hub_friction import FrictionCase

SHORT = LogChirp(end_frequency=45.0, duration=8.0, still=3.0)


@pytest.fixture(scope="module")
def case() -> FrictionCase:
    return FrictionCase(chirp=SHORT)


@pytest.mark.slow
def test_one_integrator_and_one_more_pole_find_the_friction_and_the_modes(case):
    for seed in range(2):
        outcome = case.run(seed)
        assert np.max(np.abs((outcome.estimate - case.truth) / outcome.sd)) < 4.0
        assert outcome.sd[-1] < 0.01 * case.truth[-1]


@pytest.mark.slow
def test_known_integrators_are_no_real_poles(case):
    poles, sd = case.estimate(3).real_poles()
    assert poles == pytest.approx([-case.truth[-1]], rel=0.02)
    assert sd.shape == (1,)


@pytest.mark.slow
@pytest.mark.parametrize("viscous_friction", [0.02, 0.4])
def test_a_rigid_body_without_friction_is_told_apart_from_one_with(viscous_friction):
    case = FrictionCase(viscous_friction, SHORT)
    found = identify(case.record(0), "force", n_modes=2)
    said = [warning for warning in found.warnings if "as under friction" in warning]
    assert len(said) == 1
    assert "base_motion" in said[0]
    stated = float(said[0].split("speed at ")[1].split(" rad/s")[0])
    # One step from none, and the other parameters have taken their part: too small, but of the right size.
    assert 0.2 * case.truth[-1] < stated < 1.1 * case.truth[-1]


def test_a_hub_that_rolls_freely_gives_no_such_warning():
    case = FreeHubCase(SHORT)
    for seed in range(2):
        found = identify(case.record(seed), "force", n_modes=2)
        assert not any("friction" in warning for warning in found.warnings)


def test_the_measured_position_as_the_input_does_not_know_of_friction(case):
    positions = case.hub.film(case.forces)[0][:-1]
    drive = InputSignal("hub", "m", (0.0, 1e-3), positions, "cubic")
    model = identify(TimeRecord((drive,), case.record(1).outputs), n_modes=2).model
    clamped = case.hub.model.natural_frequencies[:2]
    assert np.max(np.abs((model.natural_frequencies - clamped) / model.natural_frequency_sd)) < 4.0
