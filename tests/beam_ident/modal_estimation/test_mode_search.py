from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from beam_ident import OutputSignal, fit_free_decay
from beam_ident.modal_estimation import mode_search
from beam_ident.modal_estimation.mode_search import ModeSearch, Weighed

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


@pytest.mark.parametrize(
    ("complaint", "second", "settles", "sigma_without", "n_left"),
    [
        ("", 41.0, True, 1.0, 2),
        ("", 41.0, False, 1.0, 1),
        ("", 41.0, False, 1.2, 2),
        ("", 60.0, False, 1.0, 2),
        ("too weak", 60.0, True, 1.2, 1),
        ("too weak", 60.0, False, 1.2, 1),
    ],
    ids=["sound", "twin", "twin that explains much", "far away", "weak", "weak and unsettled"],
)
def test_a_mode_goes_when_weights_speak_against_it_or_when_it_is_the_idle_twin_of_another(
    monkeypatch, complaint, second, settles, sigma_without, n_left
):
    class Search(ModeSearch):
        band = None

        def __init__(self):
            self._present = mode_search.Tried(None, 0)
            self.entries = [self._entry(None, "")]

        def propose(self, fit, excluded):
            return []

        def fit(self, omegas, zetas, clock, *_):
            return fitted(omegas, True, sigma_without)

        def _entry(self, fit, refusal):
            return mode_search.OrderEntry(*[0] * 8, refused_because=refusal)

        def weighed(self, fit):
            return Weighed(fit, None, None)

    def fitted(omegas, converged, sigma):
        return SimpleNamespace(
            omegas=omegas,
            zetas=0.01 * np.ones(len(omegas)),
            clock=None,
            converged=converged,
            sigmas=np.array([sigma]),
            reason="did not settle",
        )

    monkeypatch.setattr(mode_search, "mode_complaint", lambda fit, problem, mode, band: complaint * mode)
    monkeypatch.setattr(mode_search, "mode_significance", lambda fit, problem, mode, band: (-mode, 1))
    search = Search()
    left = search._confirmed(Weighed(fitted(np.array([40.0, second]), settles, 1.0), None, None))
    assert left.fit.omegas.tolist() == [40.0, second][:n_left]
    assert [entry.refused_because for entry in search.entries] == (
        [f"weighed by the noise, {complaint or 'did not settle'}", ""] if n_left == 1 else [""]
    )
