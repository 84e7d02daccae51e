"""A dozen modes between 2 and 15 Hz, without a hint."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import Prior, identify
from benchmarks.ident.many_modes import ManyModes, fit_behind_truth
from benchmarks.ident.unlike_rig import unlike_rig, unseen_fits


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "n_outputs"), [(0, 2), (1, 1)])
def test_a_dozen_close_modes_are_found_although_fits_of_fewer_do_not_converge(seed, n_outputs):
    case = ManyModes(seed, 15.0, n_outputs)
    found = identify(case.record, "receptance")
    assert found.converged
    assert found.model.n_modes == 12
    assert not found.warnings
    # 12 modes cost 2 + n_outputs parameters each: sqrt(1 + 60 / 3000) of the noise, 0.2 % of FIT at 15 dB.
    assert fit_behind_truth(case, found.model) < 0.5


@pytest.mark.verify
def test_outputs_that_show_a_mode_or_two_alone_are_no_judges_of_the_others_clocks():
    # 14 modes, 3 outputs on one clock, input and outputs with 30 % lost: one output alone shows a single mode.
    system = unlike_rig(15)
    model = identify(system.first, system.structure, latency=Prior(0.0, np.inf)).model
    assert model.n_modes == system.truth.n_modes
    assert not np.any(model.output_delays)
    assert np.min(unseen_fits(system, model) - unseen_fits(system, system.truth)) > -2.5  # of 88 %
