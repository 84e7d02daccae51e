from __future__ import annotations

import numpy as np
import pytest

from beam_ident import ModalStructure, identify
from beam_ident.data.own_clocks import OwnClock
from beam_ident.modal_identification.conditions import Conditions
from benchmarks.ident.supersets import hard_record

DRIFTING = ModalStructure("receptance", has_free_response=False)
MOVING = ModalStructure("receptance")
SAME = 0.01  # in -2 log-likelihood: what two ways to one optimum may differ by


def cost(seed: int, structure: ModalStructure, n_modes: int) -> float:
    """Return -2 log-likelihood of the search's choice, before the noise weighs, without a charge for parameters."""
    found = identify(hard_record(seed, 1 + seed % 2), structure, n_modes=n_modes)
    (chosen,) = (entry for entry in found.orders if entry.is_chosen)
    assert chosen.n_modes == n_modes
    return chosen.aic - 2.0 * chosen.n_parameters


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "n_modes"),
    [
        (74, 1),  # one doubtful mode, of either
        pytest.param(
            54, 2, marks=pytest.mark.verify
        ),  # poles that settle where free motion takes the place of a mode
        (52, 1),  # an outlier, which may be the cause of the doubt
        pytest.param(62, 2, marks=pytest.mark.verify),  # a pole lies out of the band at either end
        pytest.param(40, 2, marks=pytest.mark.verify),  # a pole whose damping is as high as it may be
        (11, 3),  # a worse end whose modes are less in doubt
        pytest.param(
            64, 3, marks=pytest.mark.verify
        ),  # a better end of two modes that leads to a worse one of three
        pytest.param(22, 3, marks=pytest.mark.verify),  # slow noise that is less likely than white noise
    ],
)
def test_free_motion_that_is_asked_for_never_leads_to_a_worse_optimum(seed, n_modes):
    assert cost(seed, MOVING, n_modes) < cost(seed, DRIFTING, n_modes) + SAME


@pytest.mark.slow
def test_one_more_mode_never_leads_to_a_worse_optimum():
    # Two modes end better by way of the structure without an offset; the third has to go on from there.
    assert cost(71, DRIFTING, 3) < cost(71, DRIFTING, 2) + SAME


@pytest.mark.slow
def test_a_low_pass_behind_which_less_is_seen_is_not_taken():
    # Behind the low-pass that seemed likely two modes explain less than one does without.
    assert cost(64, DRIFTING, 2) < cost(64, DRIFTING, 1) + SAME


@pytest.mark.slow
def test_clocks_that_do_not_settle_end_at_the_likeliest_fit_and_are_named():
    terms = ModalStructure("receptance", has_offset=True, has_ramp=True)
    record = hard_record(81, 2)  # y0 is slow by a real pole; each turn moves its clock further
    fewer, more = (identify(record, terms, n_modes=n) for n in (1, 2))
    slow, at_end = fewer.outputs[0].residuals, more.outputs[0].residuals
    assert np.std(at_end) < 1.5 * np.std(slow)  # else 2.5 times, and 37 ms late
    assert any("The clocks of y0 did not settle" in own for own in more.warnings)


def test_conditions_keep_the_clocks_that_an_end_was_found_with():
    before = Conditions((), MOVING, clocks={"y0": OwnClock(1e-3)})
    after = before.moved({"y0": OwnClock(5e-3), "y1": OwnClock(2e-3, 1e-4)})
    assert after.clocks == {"y0": OwnClock(6e-3), "y1": OwnClock(2e-3, 1e-4, True)}
    assert before.clocks == {"y0": OwnClock(1e-3)}
