"""A linear recursion of a state that stays the same over many steps, block by block.

    x_(k+1) = A x_k + B u_k,    y_k = C x_k + D u_k

Inside a block of steps the outputs are a matrix product with the block's inputs and its first state, so that one
small product a block is left to recur: the same sums in another order, many times quicker than step by step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray

_BLOCK = 16


@dataclass(frozen=True, eq=False)
class StateRecursion:
    """The four matrices.

    Attributes
    ----------
    A : ndarray, shape (n_states, n_states)
    B : ndarray, shape (n_states, n_inputs)
    C : ndarray, shape (n_outputs, n_states)
    D : ndarray, shape (n_outputs, n_inputs)
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

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
        n_outputs = len(self.C)
        outputs = np.empty((n_steps, n_outputs, n_columns))
        n_blocks = n_steps // _BLOCK
        whole = n_blocks * _BLOCK
        if n_blocks > 1:
            within, ahead, begun, passed = self._block()
            blocks = np.ascontiguousarray(inputs[:whole]).reshape(n_blocks, _BLOCK * n_inputs, n_columns)
            gained = _product(begun, blocks)
            starts = np.empty((n_blocks, len(self.A), n_columns))
            for number in range(n_blocks):
                starts[number] = state
                state = passed @ state + gained[number]
            found = _product(within, blocks)
            found += _product(ahead, starts)
            outputs[:whole] = found.reshape(whole, n_outputs, n_columns)
        else:
            whole = 0
        for k in range(whole, n_steps):
            outputs[k] = self.C @ state + self.D @ inputs[k]
            state = self.A @ state + self.B @ inputs[k]
        return outputs, state

    def _block(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return what a block's inputs and first state do to its outputs, and what both do to the state after it."""
        (n_outputs, n_inputs), n_states = self.D.shape, len(self.A)
        powers = np.empty((_BLOCK + 1, n_states, n_states))
        powers[0] = np.eye(n_states)
        for k in range(_BLOCK):
            powers[k + 1] = self.A @ powers[k]
        reached = powers[:_BLOCK] @ self.B
        # An input reaches the outputs of its own step through D, those l steps later through C A^(l-1) B.
        impulse = np.zeros((_BLOCK + 1, n_outputs, n_inputs))
        impulse[0] = self.D
        impulse[1:_BLOCK] = self.C @ reached[: _BLOCK - 1]
        lags = np.arange(_BLOCK)[:, None] - np.arange(_BLOCK)[None, :]
        within = impulse[np.where(lags < 0, _BLOCK, lags)]  # (to, from, output, input)
        within = within.transpose(0, 2, 1, 3).reshape(_BLOCK * n_outputs, _BLOCK * n_inputs)
        ahead = (self.C @ powers[:_BLOCK]).reshape(_BLOCK * n_outputs, n_states)
        begun = reached[::-1].transpose(1, 0, 2).reshape(n_states, _BLOCK * n_inputs)
        return np.ascontiguousarray(within), ahead, np.ascontiguousarray(begun), powers[_BLOCK]


def _product(matrix: FloatArray, blocks: FloatArray) -> FloatArray:
    """Return ``matrix @ block`` for every block, shape (n_blocks, n_rows, n_columns)."""
    if blocks.shape[2] == 1:
        return np.asarray((blocks[:, :, 0] @ matrix.T)[:, :, None])
    return np.asarray(matrix @ blocks)
