"""What a model predicts of an output: the simulation, and what belongs to the record alone.

An output-error model takes the output's noise as white, so that past residuals predict
nothing.  An offset, and the motion that was already there when the record begins, do not
belong to the model; both are fitted to the record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import BoolArray, FloatArray
from beam_ident.data.records import InputSignal, OutputSignal
from beam_ident.numerics.linear_least_squares import LinearSolution

Simulation = Callable[[FloatArray, float], FloatArray]  # stamps and exposure [s] to the output from rest


@dataclass(frozen=True, eq=False)
class OutputPrediction:
    """An output and its prediction, where all inputs are known.

    Attributes
    ----------
    inside : ndarray of bool, shape (n_samples,) -- which of the output's samples these are
    times_s, measured, predicted : ndarray, shape (n_inside,) -- measured is NaN where nothing was seen
    offset : float -- the constant in the prediction
    simulated : ndarray, shape (n_inside,) -- from rest, with no more than a constant of the record's own
    """

    inside: BoolArray
    times_s: FloatArray
    measured: FloatArray
    predicted: FloatArray
    offset: float
    simulated: FloatArray

    @staticmethod
    def of(
        output: OutputSignal, drives: Sequence[InputSignal], simulate: Simulation, free_motions: Simulation
    ) -> OutputPrediction:
        """Predict an output.

        Parameters
        ----------
        output : OutputSignal
        drives : sequence of InputSignal
        simulate : callable -- of stamps and exposure [s]: the output from rest, shape (n,)
        free_motions : callable
            Of times since the record's begin and exposure [s]: columns of what the
            system does on its own, a constant first, shape (n, n_columns).
        """
        first = max(drive.span_s[0] for drive in drives)
        last = min(drive.span_s[1] for drive in drives)
        inside = output.is_within(first, last)
        times, measured = np.asarray(output.times_s[inside]), np.asarray(output.values[inside])
        if not len(times):
            return OutputPrediction(inside, times, measured, np.empty(0), 0.0, np.empty(0))
        simulated = simulate(times, output.exposure_s)
        own = free_motions(times - times[0] + 0.5 * output.exposure_s, output.exposure_s)
        seen = np.isfinite(measured)
        left = (measured - simulated)[seen]
        found = LinearSolution.of(own[seen]).coefficients(left)
        plain = simulated + (float(np.mean(left)) if np.any(seen) else 0.0)
        return OutputPrediction(inside, times, measured, simulated + own @ found, float(found[0]), plain)

    def everywhere(self) -> FloatArray:
        """Return the prediction at every sample, NaN where an input is not known."""
        result = np.full(len(self.inside), np.nan)
        result[self.inside] = self.predicted
        return result
