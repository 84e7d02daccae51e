from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError
from beam_ident.modal_analysis import modal_assurance, normalised, phase_collinearity
from tests.beam_ident.modal_analysis.chain import SHAPES


def test_assurance_knows_equal_and_orthogonal_shapes():
    turned = SHAPES * np.exp(1j * np.arange(5)) * np.arange(1, 6)
    np.testing.assert_allclose(modal_assurance(SHAPES, turned), np.eye(5), atol=1e-12)
    assert modal_assurance([1.0, 1.0], [1.0, 0.0])[0, 0] == pytest.approx(0.5)


def test_collinearity_is_one_for_a_real_shape_in_any_phase_and_falls_with_complexity():
    real = np.array([1.0, -0.5, 0.2]) * np.exp(0.7j)
    travelling = np.exp(2j * np.pi * np.arange(8) / 8)
    assert phase_collinearity(real)[0] == pytest.approx(1.0)
    assert phase_collinearity(travelling)[0] == pytest.approx(0.0, abs=1e-12)
    assert 0.8 < phase_collinearity(real + 0.1j * np.array([0.3, 1.0, -0.5]))[0] < 1.0


def test_shapes_are_normalised_by_their_largest_point():
    np.testing.assert_allclose(normalised([2j, -4.0, 1.0])[:, 0], [-0.5j, 1.0, -0.25])


def test_shapes_of_other_points_are_refused():
    with pytest.raises(EstimationError, match="5 and 3 points"):
        modal_assurance(SHAPES, np.ones(3))
    with pytest.raises(EstimationError, match="finite"):
        phase_collinearity([1.0, np.nan])
