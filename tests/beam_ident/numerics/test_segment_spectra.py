"""Tests of the spectra of segments, against SciPy's."""

import numpy as np
import pytest
from scipy import signal

from beam_ident.numerics.segment_spectra import segment_spectra


@pytest.mark.parametrize("length", [2, 3, 64, 65, 1000])
def test_products_of_spectra_are_one_sided_densities(length: int) -> None:
    first, second = np.random.default_rng(1).standard_normal((2, 1000)) + 3.0
    frequencies, spectra = segment_spectra(first, 0.02, length)
    others = segment_spectra(second, 0.02, length)[1]
    expected, cross = signal.csd(first, second, 50.0, nperseg=length, noverlap=length // 2)
    np.testing.assert_allclose(frequencies, expected, rtol=1e-14)
    np.testing.assert_allclose(np.mean(np.conj(spectra) * others, axis=0), cross, rtol=1e-9, atol=1e-15)
    parts = signal.spectrogram(first, 50.0, "hann", length, length // 2, detrend="constant")[2]
    np.testing.assert_allclose(np.abs(spectra.T) ** 2, parts, rtol=1e-9, atol=1e-15)
