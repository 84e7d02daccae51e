"""Tests of the rule of trapezoids."""

import numpy as np

from beam_ident.numerics.trapezoid_rule import trapezoid_rule


def test_broken_lines_are_integrated_exactly() -> None:
    places = np.array([0.0, 0.5, 2.0, 2.25])
    np.testing.assert_allclose(trapezoid_rule(3.0 * places + 1.0, places), 1.5 * 2.25**2 + 2.25)
    columns = np.stack([places, np.ones(4)], axis=1)[:, :, None]
    np.testing.assert_allclose(trapezoid_rule(columns, places)[:, 0], [0.5 * 2.25**2, 2.25])
