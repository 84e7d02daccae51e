from __future__ import annotations

import numpy as np
import pytest

from beam_ident.numerics.state_recursion import StateRecursion


@pytest.mark.parametrize(("n_inputs", "n_outputs"), [(2, 3), (7, 6)])
@pytest.mark.parametrize("is_steady", [True, False])
@pytest.mark.parametrize("n_columns", [1, 5])
@pytest.mark.parametrize("n_steps", [1, 31, 64, 100, 333])
def test_blocks_give_what_steps_give(n_steps, n_columns, is_steady, n_inputs, n_outputs):
    rng = np.random.default_rng(n_steps)
    n_own = 1 if is_steady else n_steps
    A = 0.4 * rng.standard_normal((n_own, 4, 4))
    shapes = (4, n_inputs), (n_outputs, 4), (n_outputs, n_inputs)
    B, C, D = (rng.standard_normal((n_own, *shape)) for shape in shapes)
    inputs, state = rng.standard_normal((n_steps, n_inputs, n_columns)), rng.standard_normal((4, n_columns))
    recursion = StateRecursion(A, B, C, D)
    for _ in range(2):  # what was kept of the first run serves the second
        outputs, last = recursion.run(inputs, state)
    for k in range(n_steps):
        own = 0 if is_steady else k
        np.testing.assert_allclose(outputs[k], C[own] @ state + D[own] @ inputs[k], rtol=1e-9, atol=1e-9)
        state = A[own] @ state + B[own] @ inputs[k]
    np.testing.assert_allclose(last, state, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("n_own", [1, 70])
def test_the_adjoint_is_the_transposed_map(n_own):
    rng = np.random.default_rng(0)
    A, B = 0.3 * rng.standard_normal((n_own, 3, 3)), rng.standard_normal((n_own, 3, 2))
    recursion = StateRecursion(A, B, np.swapaxes(B, 1, 2), rng.standard_normal((n_own, 2, 2)))
    inputs, weights = rng.standard_normal((2, 70, 2, 1))
    there, _ = recursion.run(inputs, np.zeros((3, 1)))
    back, _ = recursion.adjoint().run(weights[::-1], np.zeros((3, 1)))
    assert np.sum(there * weights) == pytest.approx(np.sum(inputs * back[::-1]), rel=1e-9)
