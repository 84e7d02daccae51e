"""Predicted swings against beams that are integrated by themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beam_ident import AmplitudeCurves, EstimationError
from beam_ident.shaping.command import Move, s_curve
from beam_ident.shaping.known_beam import AxisErrors, KnownBeam, PoleDrift, SwingLaw, swing_law
from beam_ident.shaping.residual import expected_disturbance, insensitivity, nominal_swings, predict_residual
from beam_ident.shaping.shapers import shaped
from tests.beam_ident.shaping.beams import LIMITS, OMEGAS, ZETAS, amplitude_after, beam_model

BASE = s_curve(0.02, LIMITS.axis, 1e-3)


def test_the_nominal_swing_is_the_sum_of_the_modes_amplitudes() -> None:
    base = s_curve(0.004, LIMITS.axis, 2e-3)
    amplitudes = [amplitude_after(base, omega, zeta) for omega, zeta in zip(OMEGAS, ZETAS, strict=True)]
    expected = np.abs(beam_model().residues) @ amplitudes
    assert nominal_swings(base, KnownBeam(beam_model())) == pytest.approx(expected, rel=1e-5)


def test_the_interval_holds_as_many_beams_as_it_says() -> None:
    beam = KnownBeam(beam_model(1e-3, 0.05))
    move = shaped(BASE, "ZV", OMEGAS[:1], ZETAS[:1])
    predicted = predict_residual(move, beam)
    low, high = predicted.interval
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(300):
        omegas = OMEGAS * (1.0 + 1e-3 * rng.standard_normal(2))
        zetas = ZETAS * (1.0 + 0.05 * rng.standard_normal(2))
        poles = omegas * (-zetas + 1j * np.sqrt(1.0 - zetas**2))
        shares = beam.model.residues * (1.0 + 1e-3 * rng.standard_normal((2, 2)))
        swing = np.abs(shares) @ (np.abs(move.end_phasors(poles)) / poles.imag)
        inside += bool(low[0] <= swing[0] <= high[0])
    # Binomial: 285 of 300, within 3.3 standard deviations.
    assert 272 <= inside <= 298
    assert predicted.probability_above(float(high[0])) == pytest.approx(0.025, abs=0.003)


def test_a_budget_widens_the_interval_and_a_model_without_covariance_is_called_nominal() -> None:
    move = shaped(BASE, "ZV", OMEGAS[:1], ZETAS[:1])
    narrow, wide = (
        predict_residual(move, KnownBeam(beam_model(), PoleDrift(sd, 0.0))).interval[1][0]
        for sd in (0.0, 5e-3)
    )
    assert wide > 2.0 * narrow
    assert KnownBeam(beam_model(0.0, 0.0)).is_nominal
    assert not KnownBeam(beam_model()).is_nominal


def hub_behind(move: Move, lag: float, before: float) -> np.ndarray:
    """Return where a hub is that friction holds a lag behind its command."""
    place, places = before * lag, []
    for wanted in move.positions:
        place = min(max(place, wanted - lag), wanted + lag)
        places.append(place)
    return np.array(places)


@pytest.mark.parametrize("before", [1.0, -1.0])
def test_frictions_lag_rings_as_the_hub_that_it_holds_back(before: float) -> None:
    lag = 2e-5
    beam = KnownBeam(beam_model(0.0, 0.0), axis=AxisErrors(lag, before=-before))
    places = hub_behind(BASE, lag, before)
    deviation = places - BASE.positions
    # A hub that jumps by S at a tick rings as much as q = -S cos does: phasors of its own steps.
    poles, n = beam.model.poles, len(places) - 1
    steps = np.diff(deviation)
    own = np.array(
        [np.sum(steps * pole * np.exp(pole * BASE.period_s * (n - np.arange(n)))) for pole in poles]
    )
    assert expected_disturbance(BASE, beam) == pytest.approx(own, rel=1e-9)
    assert (np.max(np.abs(own)) < 1e-12) == (before == -1.0), "a hub that lags already rings no more"


def test_scatter_grows_beyond_what_was_seen_and_never_below_it() -> None:
    axis = AxisErrors(1e-5, ((3.0, 6e-6), (1.0, 2e-6)))
    assert axis.scatter_at(0.1) == pytest.approx(2e-6)
    assert axis.scatter_at(2.0) == pytest.approx(4e-6)
    assert axis.scatter_at(6.0) == pytest.approx(12e-6)
    both = AxisErrors(0.0, ((1.0, 2e-6),)).joined(AxisErrors(1e-5, ((3.0, 6e-6),)))
    assert both == axis


def test_drag_and_stiffening_leave_what_the_nonlinear_beam_does() -> None:
    model = beam_model(0.0, 0.0)
    shape, lengths = np.array([0.1, 0.4, 1.0]), np.full(3, 0.1)
    law = SwingLaw(0, 0, 4e5, 0.0, 0.4, 0.0, shape, lengths)
    move = shaped(s_curve(0.03, LIMITS.axis, 1e-3), "ZV", OMEGAS, ZETAS)
    omega, zeta, share = float(OMEGAS[0]), float(ZETAS[0]), float(model.residues[0, 0])
    state = np.zeros(2)
    speeds = move.velocities

    def rate(t: float, s: np.ndarray, a: float, v: float) -> list[float]:
        stiff, drag = law.forces(np.array([v + a * t]), s[:1], s[1:])
        return [s[1], -2 * zeta * omega * s[1] - omega**2 * s[0] - share * a - float(stiff[0] + drag[0])]

    for a, v in zip(move.accelerations, speeds[:-1], strict=True):
        state = solve_ivp(rate, (0.0, 1e-3), state, args=(a, v), rtol=1e-8, atol=1e-12).y[:, -1]
    root = omega * math.sqrt(1.0 - zeta**2)
    truth = math.hypot(state[0], (state[1] + zeta * omega * state[0]) / root)
    beam = KnownBeam(model, law=law)
    ringing = expected_disturbance(move, beam)[0] + move.end_phasors(model.poles)[0]
    assert truth > 5.0 * abs(share * move.end_phasors(model.poles)[0]) / root, "the law decides"
    assert abs(share * ringing) / root == pytest.approx(truth, rel=0.02)


def test_a_law_is_read_off_curves_of_its_own_oscillator() -> None:
    amplitudes = np.linspace(0.002, 0.01, 20)
    omega, zeta, beta, kappa = OMEGAS[0], 0.005, 0.4, 4e5
    omegas = omega + 3.0 * kappa * amplitudes**2 / (8.0 * omega)
    zetas = (zeta * omega + 4.0 / (3.0 * np.pi) * beta * omega * amplitudes) / omegas
    flat = np.full(20, 1e-6)
    curves = AmplitudeCurves(
        amplitudes,
        omegas / (2 * np.pi),
        np.stack([omegas, omegas]),
        zetas,
        np.stack([zetas, zetas]),
        flat,
        flat,
        False,
        0.0,
        "",
        0.01,
        np.array([omega, 0.0]),
        np.array([0.0, 0.0]),
        np.zeros((4, 4)),
        "tip",
        "m",
        flat[:1],
        True,
        "",
        1,
        (),
    )
    law, at_rest, damping = swing_law(curves, beam_model(), np.ones(1), np.ones(1))
    assert (law.mode, law.output) == (0, 0)
    assert law.drag == pytest.approx(beta, rel=0.01)
    assert law.stiffening == pytest.approx(kappa, rel=0.01)
    assert (at_rest, damping) == pytest.approx((omega, zeta), rel=1e-3)
    with pytest.raises(EstimationError, match="--amplitude"):
        swing_law(
            AmplitudeCurves(**{**vars(curves), "output_name": "elsewhere"}),
            beam_model(),
            np.ones(1),
            np.ones(1),
        )


def test_the_curve_over_the_error_of_frequency_is_lowest_where_the_mode_is() -> None:
    beam = KnownBeam(beam_model())
    move = shaped(BASE, "ZVD", OMEGAS, ZETAS)
    left = insensitivity(move, beam, np.array([-0.02, 0.0, 0.02]))
    assert left[1] == pytest.approx(float(np.max(nominal_swings(move, beam))))
    assert min(left[0], left[2]) > 10.0 * left[1]


def test_a_force_as_input_no_modes_and_numbers_that_mean_nothing_are_refused() -> None:
    import dataclasses

    with pytest.raises(EstimationError, match="hub's motion as input"):
        KnownBeam(dataclasses.replace(beam_model(), structure="receptance"))
    with pytest.raises(EstimationError, match="finite lengths"):
        AxisErrors(lag=math.nan)
    with pytest.raises(EstimationError, match="from 0 to 1"):
        PoleDrift(frequency_sd=-0.1)
