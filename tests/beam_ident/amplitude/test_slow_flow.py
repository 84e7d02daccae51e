from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beam_ident.amplitude.slow_flow import decay_rate, frequency, slow_flow

STAMPS = np.sort(np.random.default_rng(3).uniform(0.0, 12.0, 400))


@pytest.mark.parametrize(
    "rates",
    [[0.0, 0.1], [0.02, 0.1, 0.3], [0.0, 0.05, 0.2, 0.4], [0.0, 0.6]],
    ids=["linear", "all", "cubic", "fast"],
)
def test_amplitude_and_phase_obey_their_equations(rates: list[float]) -> None:
    w, g = np.array([27.0, 0.8, -0.1]), np.array(rates)
    A, phase = slow_flow(w, g, 1.1, STAMPS)

    def slope(_t: float, y: np.ndarray) -> list[float]:
        return [-float(decay_rate(g, y[0])) if y[0] > 0.0 else 0.0, float(frequency(w, y[0]))]

    truth = solve_ivp(slope, (0.0, 12.0), [1.1, 0.0], t_eval=STAMPS, rtol=1e-11, atol=1e-13, max_step=0.01).y
    alive = truth[0] > 1e-3
    assert A[alive] == pytest.approx(truth[0][alive], rel=1e-6)
    assert phase[alive] == pytest.approx(truth[1][alive], abs=1e-6)


def test_dry_friction_ends_the_motion_at_a_finite_time() -> None:
    A, _ = slow_flow(np.array([27.0]), np.array([0.5]), 1.0, STAMPS)
    assert pytest.approx(np.maximum(1.0 - 0.5 * STAMPS, 0.0), abs=1e-3) == A
    assert np.all(A[STAMPS > 2.1] == 0.0)
