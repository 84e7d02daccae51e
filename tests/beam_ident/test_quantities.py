from __future__ import annotations

import numpy as np
import pytest

from beam_ident.quantities import interval, nearest_mode, small, with_uncertainty


def test_values_are_rounded_to_their_uncertainty():
    assert with_uncertainty(4.38412345, 0.000123) == "4.38412 ± 0.00012"
    assert with_uncertainty(123.456, 12.0) == "123 ± 12"
    assert with_uncertainty(2.0, 0.0) == "2"
    assert with_uncertainty(-5.69141e-7, 6.2e-7) == "(-5.7 ± 6.2)e-07"
    assert with_uncertainty(4.8e-6, 0.0023) == "0.0000 ± 0.0023"


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (4.38391, 0.00123, "4.3839 ± 0.0012"),
        (-0.25, 0.5, "-0.25 ± 0.50"),
        (1234.5, 67.0, "1234 ± 67"),
        (1.234e-6, 2.1e-8, "(1.234 ± 0.021)e-06"),
        (-3e-9, 4.4e-8, "(-0.3 ± 4.4)e-08"),
        (1.5, 0.0, "1.5"),
        (1.5, float("inf"), "1.5"),
    ],
)
def test_a_number_is_written_to_two_digits_of_its_uncertainty(value, sd, text):
    assert with_uncertainty(value, sd) == text


def test_an_interval_holds_95_percent_and_is_not_made_up():
    assert interval(10.0, 1.0) == "8.0 to 12.0"
    assert interval(10.0, float("nan")) == interval(10.0, 0.0) == "–"
    assert small(float("nan")) == "–"


def test_a_mode_farther_than_a_quarter_off_is_another_mode():
    omegas = np.array([10.0, 100.0])
    assert nearest_mode(omegas, 11.0) == 0
    assert nearest_mode(omegas, 120.0) == 1
    assert nearest_mode(omegas, 130.0) is None
    assert nearest_mode(np.empty(0), 1.0) is None
