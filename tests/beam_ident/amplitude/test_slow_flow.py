from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beam_ident.amplitude.slow_flow import phase_rate, rate_polynomial, ringing, slow_flow
from tests.beam_ident.amplitude.oscillators import OMEGA, UNIT, Oscillator

STAMPS = np.sort(np.random.default_rng(3).uniform(0.0, 12.0, 400))


@pytest.mark.slow
@pytest.mark.parametrize(
    "rates",
    [[0.0, 0.1], [0.02, 0.1, 0.3], [0.0, 0.05, 0.2, 0.4], [0.0, 0.6]],
    ids=["linear", "all", "cubic", "fast"],
)
def test_amplitude_and_phase_obey_their_equations(rates: list[float]) -> None:
    w, g = np.array([27.0, 0.8, -0.1]), np.array(rates)
    flow = slow_flow(w, g, 1.1, STAMPS)
    A, phase = flow.amplitude, flow.phase

    def slope(_t: float, y: np.ndarray) -> list[float]:
        rate = float(np.polynomial.polynomial.polyval(y[0], rate_polynomial(w, g)))
        return [-rate if y[0] > 0.0 else 0.0, float(phase_rate(w, g, y[:1])[0])]

    truth = solve_ivp(slope, (0.0, 12.0), [1.1, 0.0], t_eval=STAMPS, rtol=1e-11, atol=1e-13, max_step=0.01).y
    alive = truth[0] > 2e-2  # within less than a cycle of its end, dry friction is no small force
    assert A[alive] == pytest.approx(truth[0][alive], rel=1e-6)
    assert phase[alive] == pytest.approx(truth[1][alive], abs=1e-6)


def test_dry_friction_ends_the_motion_at_a_finite_time() -> None:
    A = slow_flow(np.array([27.0]), np.array([0.5, 0.0]), 1.0, STAMPS).amplitude
    assert pytest.approx(np.maximum(1.0 - 0.5 * STAMPS, 0.0), abs=1e-3) == A
    assert np.all(A[STAMPS > 2.1] == 0.0)


@pytest.mark.first_case
@pytest.mark.parametrize(
    "oscillator",
    [
        Oscillator(zeta=0.02),
        Oscillator(hardening=0.01),
        Oscillator(hardening=-0.01, quadratic=0.004),
        Oscillator(quadratic=0.01),
        Oscillator(hardening=0.005, dry=0.001),
    ],
    ids=["linear", "cubic", "soft", "quadratic", "dry"],
)
def test_second_order_says_what_reversals_and_crossings_show(oscillator: Oscillator) -> None:
    """Errors are of third order; to first order, the frequency errs by 4e-5 to 3e-4, damping by up to a hundredth."""
    maxima, frequencies_hz, damping_ratios = (
        values[:-3] for values in oscillator.curves(8.0)
    )  # the last cycles before dry friction ends the motion are few
    w = OMEGA * np.array([np.sqrt(1.0 - oscillator.zeta**2), oscillator.hardening])
    g = OMEGA * np.array([oscillator.dry, oscillator.zeta, oscillator.quadratic])
    omega, zeta = ringing(w, g, oscillator.hardening / 12.0, maxima / UNIT)
    eta = np.abs(omega / w[0] - 1.0) + zeta
    assert np.all(np.abs(omega / (2.0 * np.pi * frequencies_hz) - 1.0) < 1e-7 + 5.0 * eta**3 + 0.1 * zeta**2)
    # Maxima are read off samples a quarter of a millisecond apart.
    assert np.all(np.abs(zeta / damping_ratios - 1.0) < 1e-4 + 10.0 * eta**2)


def test_derivatives_are_those_of_the_motion() -> None:
    w, g, start = np.array([27.0, 0.8, -0.1]), np.array([0.02, 0.1, 0.3, 0.05]), 1.1
    flow = slow_flow(w, g, start, STAMPS, slopes=True)
    point, step = np.concatenate([w, g, [start]]), 1e-5
    for k, (by_amplitude, by_phase) in enumerate(zip(flow.by_amplitude, flow.by_phase, strict=True)):
        ends = []
        for sign in (1.0, -1.0):
            moved = point + sign * step * (np.arange(len(point)) == k)
            ends.append(slow_flow(moved[:3], moved[3:7], float(moved[7]), STAMPS))
        alive = flow.amplitude > 5e-2  # where friction ends the motion, its derivative breaks off
        for own, found in (
            (by_amplitude, (ends[0].amplitude - ends[1].amplitude) / (2.0 * step)),
            (by_phase, (ends[0].phase - ends[1].phase) / (2.0 * step)),
        ):
            assert own[alive] == pytest.approx(found[alive], abs=1e-3 * np.abs(found[alive]).max())
