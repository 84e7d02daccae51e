from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import argrelmin

from beam_ident.modal_analysis import complex_mode_indicator, multivariate_mode_indicator
from tests.beam_ident.modal_analysis.chain import FREQUENCIES_HZ, LINES, noisy_record


def test_singular_values_peak_at_the_first_mode():
    found = complex_mode_indicator(noisy_record(0, 0.0, (0, 2)))
    assert found.shape == (5000, 2)
    assert np.all(found[:, 0] >= found[:, 1])
    assert LINES[np.argmax(found[:, 0])] / (2 * np.pi) == pytest.approx(50.0, abs=0.5)


@pytest.mark.parametrize("differentiations", [0, 1, 2])
def test_the_multivariate_indicator_dips_at_the_modes(differentiations):
    record = noisy_record(0, 0.0, (0, 1, 2, 3, 4), differentiations)
    smallest = multivariate_mode_indicator(record, differentiations)[:, 0]
    assert np.all((smallest > -1e-9) & (smallest < 1.0 + 1e-9))
    dips = argrelmin(smallest)[0]
    hertz = record.frequencies_hz[dips[smallest[dips] < 0.1]]
    np.testing.assert_allclose(hertz, FREQUENCIES_HZ, rtol=0.01)
