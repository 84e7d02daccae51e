from __future__ import annotations

import numpy as np

from beam_ident import OutputSignal, fit_free_decay

TIMES = 0.01 * np.arange(500)
NOISE = np.random.default_rng(0).standard_normal(500)
RINGING = np.exp(-0.4 * TIMES) * np.cos(40.0 * TIMES) + 0.3 * np.exp(-0.9 * TIMES) * np.sin(90.0 * TIMES)


def test_two_modes_are_chosen_and_the_third_is_listed_with_the_reason_against_it():
    found = fit_free_decay(OutputSignal("y", "m", TIMES, RINGING + 0.01 * NOISE))
    np.testing.assert_allclose(found.natural_frequencies, [40.0, 90.0], rtol=1e-3)
    assert [order.n_modes for order in found.orders if order.is_chosen] == [2]
    chosen = next(order for order in found.orders if order.is_chosen)
    assert not chosen.refused_because
    assert all(order.refused_because for order in found.orders if order.n_modes > 2)
    assert {order.n_modes for order in found.orders} >= {0, 1, 2, 3}


def test_a_number_of_modes_that_is_asked_for_is_given():
    found = fit_free_decay(OutputSignal("y", "m", TIMES, RINGING + 0.01 * NOISE), n_modes=3)
    assert len(found.natural_frequencies) == 3
    assert [order.n_modes for order in found.orders if order.is_chosen] == [3]
