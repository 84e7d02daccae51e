"""A dozen modes between 2 and 15 Hz, without a hint."""

from __future__ import annotations

import pytest

from beam_ident import identify
from benchmarks.ident.many_modes import ManyModes, fit_behind_truth


@pytest.mark.parametrize(("seed", "n_outputs"), [(0, 2), (1, 1)])
def test_a_dozen_close_modes_are_found_although_fits_of_fewer_do_not_converge(seed, n_outputs):
    case = ManyModes(seed, 15.0, n_outputs)
    found = identify(case.record, "receptance")
    assert found.converged
    assert found.model.n_modes == 12
    assert not found.warnings
    # 12 modes cost 2 + n_outputs parameters each: sqrt(1 + 60 / 3000) of the noise, 0.2 % of FIT at 15 dB.
    assert fit_behind_truth(case, found.model) < 0.5
