"""Twelfth order: six modes under force, without a hint."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import identify
from benchmarks.ident.forced_beam import PLAIN
from benchmarks.ident.six_modes import SixModeBeam


@pytest.mark.slow
def test_six_modes_are_found_and_nothing_but_the_noise_is_left():
    beam = SixModeBeam()
    record, exact = beam.record(3, 40.0), beam.record(3, 40.0, quiet=0.0)
    found = identify(record, PLAIN)
    assert found.model.n_modes == 6
    for fit, noisy, clean in zip(found.outputs, record.outputs, exact.outputs, strict=True):
        # 24 parameters take a thousandth of the noise of 25 000 samples with them.
        assert 0.99 < np.var(fit.residuals) / np.var(noisy.values - clean.values) < 1.001
