from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beam_model import AirDrag, BeamModel, BeamParameterError, Damping, NonlinearMotionStepper, NonlinearTerms
from beam_model.dynamics.amplitude_laws import AmplitudeLaw, amplitude_law
from tests.beam_model.rigs import strip


@pytest.mark.parametrize(("mode", "expected"), [(0, 0.0194), (1, -6.454), (2, -55.98)])
def test_the_shift_is_that_of_the_modes_energies(mode: int, expected: float) -> None:
    law = amplitude_law(BeamModel(strip(), 3), mode, 0.30)
    assert law.hardening * 0.30**2 == pytest.approx(expected, rel=2e-3)
    low = amplitude_law(BeamModel(strip(), 3), mode, 0.20)
    share = BeamModel(strip(), 3).shape([0.20, 0.30])[:, mode]
    assert low.hardening * share[0] ** 2 == pytest.approx(law.hardening * share[1] ** 2, rel=1e-9)


def swing(model: BeamModel, drag: AirDrag | None) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights of the maxima of a tip that is let go at 40 mm."""
    stepper = NonlinearMotionStepper(model, 1e-3, NonlinearTerms(model, drag))
    tip = float(model.shape([0.30])[0, 0])
    stepper.state = np.array([0.04 / tip, 0.0])
    w = tip * stepper.run(np.zeros(4000))[:, 0]
    k = 1 + np.flatnonzero((w[1:-1] > w[:-2]) & (w[1:-1] > w[2:]))
    # Each maximum is placed by the parabola through three samples.
    bend, rise = w[k - 1] - 2.0 * w[k] + w[k + 1], 0.5 * (w[k + 1] - w[k - 1])
    return 1e-3 * (k - rise / bend), w[k] - 0.5 * rise**2 / bend


@pytest.mark.slow
def test_a_swing_integrated_in_time_obeys_the_law() -> None:
    model = BeamModel(strip(damping=Damping(viscous=0.05), gravity="upright", tip_mass=1e-3), 1)
    times, peaks = swing(model, None)
    law, middle = amplitude_law(model, 0, 0.30), np.sqrt(peaks[:-1] * peaks[1:])
    assert 2.0 * np.pi / np.diff(times) == pytest.approx(law.frequencies(middle), rel=3e-5)
    drag = AirDrag(0.025, coefficient=20.0)
    _, peaks = swing(model, drag)
    law, middle = amplitude_law(model, 0, 0.30, drag), np.sqrt(peaks[:-1] * peaks[1:])
    found = np.log(peaks[:-1] / peaks[1:]) / (2.0 * np.pi)
    assert found == pytest.approx(law.damping_ratios(middle), rel=0.01)


@pytest.mark.parametrize(("linear", "drag"), [(0.005, 0.02), (0.02, 0.05), (0.0, 0.03)])
def test_the_ringing_of_a_dragged_oscillator_crosses_zero_at_the_laws_frequency(linear, drag):
    force = drag * 3.0 * np.pi / 4.0  # of |x'| x': zeta_q = 4 beta A/(3 pi) at omega = 1

    def derivative(t: float, x: np.ndarray) -> list[float]:
        return [x[1], -2.0 * linear * x[1] - force * abs(x[1]) * x[1] - x[0]]

    crossings, turns = (lambda t, x, k=k: x[k] for k in (0, 1))
    ringing = solve_ivp(
        derivative, (0.0, 60.0), [1.0, 0.0], events=[crossings, turns], rtol=1e-11, atol=1e-13, max_step=0.05
    )
    peaks = np.abs(ringing.y_events[1][:, 0])
    at = np.searchsorted(ringing.t_events[1], ringing.t_events[0][:-1])  # the maximum between two crossings
    found = np.pi / np.diff(ringing.t_events[0])
    np.testing.assert_allclose(found, AmplitudeLaw(1.0, linear, 0.0, drag).frequencies(peaks[at]), rtol=2e-6)


def test_a_height_without_motion_is_refused() -> None:
    model = BeamModel(strip(), 2)
    with pytest.raises(BeamParameterError, match="Take the tip"):
        amplitude_law(model, 0, 0.0)
    with pytest.raises(BeamParameterError, match="an index from 0 to 1"):
        amplitude_law(model, 2, 0.3)
