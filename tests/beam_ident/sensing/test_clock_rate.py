from __future__ import annotations

import re

import numpy as np
import pytest

from beam_ident import (
    InputSignal,
    OutputSignal,
    TimeRecord,
    TransferFunctionModel,
    estimate_common_poles,
    hammer_response,
    local_polynomial_response,
    welch_response,
)
from beam_ident.sensing.clock_rate import clocks_of_record

OMEGA, ZETA, PERIOD_S = 20.0, 0.05, 0.01
PLANT = TransferFunctionModel(
    np.array([OMEGA**2]), np.array([1.0, 2.0 * ZETA * OMEGA, OMEGA**2]), 0.0, np.zeros((4, 4)), 0.0
)
RATES = [-0.01, 0.005, 0.007, 0.013, 0.02]


def record(seed: int, rate: float, n: int = 4096, blows: tuple[int, ...] = ()) -> TimeRecord:
    """Return two outputs of a plant under noise, or under blows, whose stamps run fast."""
    rng = np.random.default_rng(seed)
    values = np.convolve(rng.standard_normal(n), np.ones(3), mode="same")
    if blows:
        values = np.zeros(n)
        for start in blows:
            values[start : start + 4] = [0.5, 1.0, 1.0, 0.5]
    drive = InputSignal("u", "", (0.0, PERIOD_S), values, "linear")
    stamps = PERIOD_S * np.arange(1, n - 1)
    clean = PLANT.simulate(drive, stamps)
    level = 0.02 * np.std(clean)
    outputs = [
        OutputSignal(name, "", (1.0 + rate) * stamps, gain * clean + level * rng.standard_normal(len(stamps)))
        for name, gain in (("y", 1.0), ("z", -0.5))
    ]
    return TimeRecord((drive,), tuple(outputs))


def said_rate(warnings: tuple[str, ...]) -> list[float]:
    """Return the rates that the warnings name."""
    return [
        float(own) / 100.0 for said in warnings for own in re.findall(r"clock runs ([-+][\d.]+)% fast", said)
    ]


@pytest.mark.parametrize("rate", RATES)
def test_a_clock_wrong_by_a_per_cent_is_named_with_its_rate(rate):
    found = clocks_of_record(record(1, rate).outputs, record(1, rate).inputs[0])
    np.testing.assert_allclose(said_rate(tuple(found)), [rate, rate], atol=0.002)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("estimate", [welch_response, local_polynomial_response])
def test_a_response_names_it(estimate, rate):
    assert any("clock" in said for said in estimate(record(2, rate)).fit_warnings)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [-0.01, 0.01])
def test_a_fit_with_common_poles_names_it(rate):
    assert any("clock" in said for said in estimate_common_poles(record(3, rate, 1500), 2, 0).warnings)


@pytest.mark.parametrize("rate", [-0.01, 0.005, 0.02])
def test_blows_name_it_with_its_rate(rate):
    own = record(4, rate, 2400, (50, 800, 1600))
    np.testing.assert_allclose(said_rate(hammer_response(own).warnings), [rate, rate], atol=0.001)


@pytest.mark.slow
def test_right_clocks_are_not_doubted():
    for seed in range(40):
        own = record(seed, 0.0, 4096 if seed % 2 else 1000, (50, 400, 700) if seed % 4 == 0 else ())
        assert not clocks_of_record(own.outputs, own.inputs[0])
    assert not said_rate(hammer_response(record(4, 0.0, 2400, (50, 800, 1600))).warnings)


def test_stamps_that_are_not_regular_tell_nothing():
    own = record(1, 0.01)
    rng = np.random.default_rng(0)
    stamps = own.outputs[0].times_s + 0.3 * PERIOD_S * rng.random(len(own.outputs[0].times_s))
    outputs = (OutputSignal("y", "", stamps, own.outputs[0].values),)
    assert not clocks_of_record(outputs, own.inputs[0])
