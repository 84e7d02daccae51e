from __future__ import annotations

import numpy as np
import pytest

from beam_ident.numerics.state_recursion import StateRecursion


@pytest.mark.parametrize("n_columns", [1, 5])
@pytest.mark.parametrize("n_steps", [1, 31, 64, 100, 333])
def test_blocks_give_what_steps_give(n_steps, n_columns):
    rng = np.random.default_rng(n_steps)
    A = 0.4 * rng.standard_normal((4, 4))
    B, C, D = (rng.standard_normal(shape) for shape in ((4, 2), (3, 4), (3, 2)))
    inputs, state = rng.standard_normal((n_steps, 2, n_columns)), rng.standard_normal((4, n_columns))
    outputs, last = StateRecursion(A, B, C, D).run(inputs, state)
    for k in range(n_steps):
        np.testing.assert_allclose(outputs[k], C @ state + D @ inputs[k], rtol=1e-9, atol=1e-9)
        state = A @ state + B @ inputs[k]
    np.testing.assert_allclose(last, state, rtol=1e-9, atol=1e-9)
