"""A linear recursion of a state, block by block.

    x_(k+1) = A_k x_k + B_k u_k,    y_k = C_k x_k + D_k u_k

Inside a block of steps the outputs are a matrix product with the block's inputs and its first state, so that one
small product a block is left to recur: the same sums in another order, many times quicker than step by step.
What the blocks need is made once: of matrices that stay the same for one block, of others for all blocks together.
Where inputs and outputs outnumber the states, the states alone recur.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beam_ident.arrays import FloatArray

_BLOCK = 16


@dataclass(frozen=True, eq=False)
class StateRecursion:
    """The four matrices: of every step, or of one that all steps are alike.

    Attributes
    ----------
    A : ndarray, shape (n_steps or 1, n_states, n_states)
    B : ndarray, shape (n_steps or 1, n_states, n_inputs)
    C : ndarray, shape (n_steps or 1, n_outputs, n_states)
    D : ndarray, shape (n_steps or 1, n_outputs, n_inputs)
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

    def adjoint(self) -> StateRecursion:
        """Return the recursion that the transposed map is, from the last step to the first."""
        turned = (np.swapaxes(own, 1, 2)[::-1] for own in (self.A, self.C, self.B, self.D))
        return StateRecursion(*turned)

    def run(self, inputs: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the outputs and the state after the last step.

        Parameters
        ----------
        inputs : ndarray, shape (n_steps, n_inputs, n_columns) -- columns are runs of their own
        state : ndarray, shape (n_states, n_columns) -- before the first step

        Returns
        -------
        outputs : ndarray, shape (n_steps, n_outputs, n_columns)
        state : ndarray, shape (n_states, n_columns)
        """
        n_steps, n_inputs, n_columns = inputs.shape
        n_outputs, n_states = self.C.shape[1:]
        if min(n_inputs, n_outputs) > n_states:
            before, state = self._states_alone.run(self.B @ inputs, state)
            outputs = self.D @ inputs
            outputs += self.C @ before
            return outputs, state
        outputs = np.empty((n_steps, n_outputs, n_columns))
        n_blocks = n_steps // _BLOCK
        whole = n_blocks * _BLOCK if n_blocks > 1 else 0
        if whole:
            within, ahead, begun, passed = self._blocks
            blocks = np.ascontiguousarray(inputs[:whole]).reshape(n_blocks, _BLOCK * n_inputs, n_columns)
            gained = _product(begun, blocks)
            starts = np.empty((n_blocks, n_states, n_columns))
            ahead_of = np.broadcast_to(passed, (n_blocks, n_states, n_states))
            for number in range(n_blocks):
                starts[number] = state
                state = ahead_of[number] @ state + gained[number]
            found = _product(within, blocks)
            found += _product(ahead, starts)
            outputs[:whole] = found.reshape(whole, n_outputs, n_columns)
        for k in range(whole, n_steps):
            own = min(k, len(self.A) - 1)
            outputs[k] = self.C[own] @ state + self.D[own] @ inputs[k]
            state = self.A[own] @ state + self.B[own] @ inputs[k]
        return outputs, state

    @cached_property
    def _states_alone(self) -> StateRecursion:
        """What is left to recur where inputs and outputs are many: from what enters the states to the states."""
        same = np.broadcast_to(np.eye(self.A.shape[1]), self.A.shape)
        return StateRecursion(self.A, same, same, np.zeros_like(self.A))

    @cached_property
    def _blocks(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """What a block's inputs and first state do to its outputs, and what both do to the state after it."""
        n_blocks = max(len(self.A) // _BLOCK, 1)

        def of_blocks(matrices: FloatArray) -> FloatArray:
            if len(matrices) == 1:
                return np.broadcast_to(matrices, (1, _BLOCK, *matrices.shape[1:]))
            return matrices[: n_blocks * _BLOCK].reshape(n_blocks, _BLOCK, *matrices.shape[1:])

        A, B, C, D = map(of_blocks, (self.A, self.B, self.C, self.D))
        (n_outputs, n_inputs), n_states = self.D.shape[1:], self.A.shape[1]
        within = np.zeros((n_blocks, _BLOCK, n_outputs, _BLOCK, n_inputs))  # (to, output, from, input)
        ahead = np.empty((n_blocks, _BLOCK, n_outputs, n_states))
        reached = np.zeros((n_blocks, n_states, _BLOCK * n_inputs))  # the state, by the inputs so far
        passed = np.broadcast_to(np.eye(n_states), (n_blocks, n_states, n_states))  # by the first state
        for k in range(_BLOCK):
            ahead[:, k] = C[:, k] @ passed
            within[:, k] = (C[:, k] @ reached).reshape(n_blocks, n_outputs, _BLOCK, n_inputs)
            within[:, k, :, k] = D[:, k]
            reached = A[:, k] @ reached
            reached[:, :, k * n_inputs : (k + 1) * n_inputs] = B[:, k]
            passed = A[:, k] @ passed
        return (
            within.reshape(n_blocks, _BLOCK * n_outputs, _BLOCK * n_inputs),
            ahead.reshape(n_blocks, _BLOCK * n_outputs, n_states),
            reached,
            passed,
        )


def _product(matrices: FloatArray, blocks: FloatArray) -> FloatArray:
    """Return ``matrix @ block`` for every block, shape (n_blocks, n_rows, n_columns)."""
    if len(matrices) == 1 and blocks.shape[2] == 1:
        return np.asarray((blocks[:, :, 0] @ matrices[0].T)[:, :, None])
    return np.asarray(matrices @ blocks)
