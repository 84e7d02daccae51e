from __future__ import annotations

import numpy as np
import pytest

from beam_ident.modal.frequency_response import ModalFrequencyResponse


def test_magnitude_and_phase_scatter_along_and_across_the_response():
    # Real and imaginary part of 3 + 4i with variances of their own; and a response of exactly zero.
    response = np.array([[3.0 + 4.0j], [0.0]])
    covariance = np.tile(np.diag([0.01, 0.04]), (2, 1, 1, 1))
    found = ModalFrequencyResponse(np.array([1.0, 2.0]), ("tip",), response, covariance)
    along, across = (9 * 0.01 + 16 * 0.04) / 25, (16 * 0.01 + 9 * 0.04) / 25
    assert found.magnitude_sd[0, 0] == pytest.approx(np.sqrt(along), rel=1e-12)
    assert found.phase_sd[0, 0] == pytest.approx(np.sqrt(across) / 5.0, rel=1e-12)
    assert np.all(np.isfinite([found.magnitude_sd, found.phase_sd]))
