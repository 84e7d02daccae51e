from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete

from beam_ident.transfer_function.sampled_controller import SampledController

PERIOD_S, SCALE = 0.02, 3.0
PLANT = ([2.0, 8.0], [1.0, 1.2, 9.0])  # b_1 s + b_0 over s^2 + a_1 s + a_2, in units of the scale


def loop_step_by_step(controller: SampledController, reference: np.ndarray) -> np.ndarray:
    """Run plant and controller tick by tick, each by its own difference equation."""
    top = [PLANT[0][0] * SCALE, PLANT[0][1] * SCALE**2]
    bottom = [1.0, PLANT[1][1] * SCALE, PLANT[1][2] * SCALE**2]
    b, a, _ = cont2discrete((top, bottom), PERIOD_S, "zoh")
    b, c, d = b[0], controller.numerator, controller.denominator
    u, y, v, e = (np.zeros(len(reference)) for _ in range(4))

    def past(coefficients, values, k):
        return sum(coefficients[i] * values[k - i] for i in range(1, len(coefficients)) if k >= i)

    for k in range(len(reference)):
        y[k] = past(b, u, k) - past(a, y, k)
        e[k] = reference[k] - y[k] if controller.reference_enters == "error" else -y[k]
        v[k] = (c[0] * e[k] + past(c, e, k) - past(d, v, k)) / d[0]
        u[k] = v[k] if controller.reference_enters == "error" else reference[k] + v[k]
    return u


@pytest.mark.parametrize("reference_enters", ["error", "input"])
@pytest.mark.parametrize(
    ("numerator", "denominator"),
    [
        ([0.8], [1.0]),
        ([0.9, -0.5], [1.0, -0.6]),
        ([1.8, -1.0, 0.1], [2.0, -1.2]),
        ([0.0, 0.7], [1.0, -0.3, 0.1]),
    ],
    ids=["gain", "first order", "longer above", "late"],
)
def test_the_input_of_a_loop_without_noise_is_that_of_the_loop_tick_by_tick(
    numerator, denominator, reference_enters
):
    controller = SampledController(numerator, denominator, PERIOD_S, reference_enters)
    reference = np.random.default_rng(0).standard_normal(200)
    theta = np.array([*PLANT[1][1:], *PLANT[0][::-1]])
    (found,) = controller.plant_inputs(theta, 2, SCALE, [reference])
    np.testing.assert_allclose(found, loop_step_by_step(controller, reference), atol=1e-9)


def test_an_unstable_loop_has_no_input():
    theta = np.array([*PLANT[1][1:], *PLANT[0][::-1]])
    assert SampledController([300.0], [1.0], PERIOD_S).plant_inputs(theta, 2, SCALE, [np.ones(9)]) is None
