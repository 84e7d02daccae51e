"""Weights of the search where the input is noisy: rows whitened by what its noise does to the outputs.

Noise on a measured input passes through the modes that are there, and behind them it looks like more modes beside
them; and as it is in the columns too, modes that are not there can take some of it back.  So the search looks at the
most likely inputs under the model so far, whose noise is independent of what the outputs leave, and a Kalman filter
of the disturbance (``input_disturbance``), for each output by itself, makes that white.  What outputs have in common
of the noise is left to the last fit, so that every output keeps linear parameters of its own.

The same filter turns the residuals of the last fit white, before causes of a misfit are looked for in them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.prior import Prior
from beam_ident.data.records import TimeRecord
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_estimation.input_disturbance import DisturbanceFilter, InputDisturbance, Observations
from beam_ident.modal_estimation.weighted_fit import WeightedFit
from beam_ident.noise.input_noise import Smoothing
from beam_ident.sensing.misfit_causes import Turn

_MIN_SHARE = 1e-4  # of an output's noise variance: it is never taken to have less of its own


@dataclass(frozen=True, eq=False)
class InputNoiseWeights:
    """What the noise on the inputs does to every output, as a model with some of the modes says.

    Attributes
    ----------
    records : list of TimeRecord -- on their most likely inputs
    disturbances : list of list of InputDisturbance -- of every output in each of its segments
    variances : ndarray, shape (n_records, n_outputs) -- of the outputs' own noise
    latency : float -- [s]
    """

    records: list[TimeRecord]
    disturbances: list[list[InputDisturbance]]
    variances: FloatArray
    latency: float

    @staticmethod
    def of(
        records: Sequence[TimeRecord],
        regression: ModalRegression,
        fit: ModalFit,
        priors: tuple[Prior, Prior],
        smoothing: Smoothing,
    ) -> InputNoiseWeights:
        """Return those of one input in each record.

        Parameters
        ----------
        records : sequence of TimeRecord
        regression : ModalRegression -- of them, with equal weights, on smoothed inputs
        fit : ModalFit -- of the same columns, with one mode at least and residuals as measured
        priors : tuple of Prior -- of latency and clock rate
        smoothing : Smoothing
        """
        likely, variances = WeightedFit(records, regression, fit, *priors, smoothing).on_likely_inputs()
        disturbances = _by_output(records, regression, fit, smoothing)
        return InputNoiseWeights(likely, disturbances, variances, fit.clock.latency)

    def turned(self, regression: ModalRegression) -> ModalRegression:
        """Return the regression of the same outputs, at these or at fewer stamps, with rows that are white."""
        return regression.turned([self._turn(regression, j) for j in range(regression.n_outputs)])

    @staticmethod
    def of_residuals(
        records: Sequence[TimeRecord], regression: ModalRegression, fit: ModalFit, smoothing: Smoothing
    ) -> InputNoiseWeights:
        """Return those of a fit that was weighed by that noise: records, regression and smoothing are its own."""
        own_shares = np.maximum(1.0 - fit.input_noise_shares, _MIN_SHARE)
        variances = np.tile(np.square(fit.sigmas) * own_shares, (len(records), 1))
        disturbances = _by_output(records, regression, fit, smoothing)
        return InputNoiseWeights(list(records), disturbances, variances, fit.clock.latency)

    def turns(self, regression: ModalRegression, output: int) -> list[Turn]:
        """Return of every record of an output the map that makes its rows there white, each (n_rows, n_columns)."""
        result: list[Turn] = []
        for number, (record, part) in enumerate(regression.segments[output]):
            rows = np.arange(part.stop - part.start)
            seen = Observations.of([regression.times[output][part] - self.latency], [rows])
            own = self.disturbances[output][number].filter(seen, self.variances[record, output : output + 1])
            result.append(functools.partial(_whitened, own))
        return result

    def _turn(self, regression: ModalRegression, output: int) -> Callable[[FloatArray], FloatArray]:
        """Return the map of an output's rows, of determinant one: costs before and after compare."""
        filters = self._filters(regression, output)
        n_rows = len(regression.values[output])
        scale = np.exp(sum(own.log_determinant for own in filters) / n_rows)

        def turn(columns: FloatArray) -> FloatArray:
            result = np.array(columns, order="C")
            for own in filters:
                own.whiten([result])
            return np.asarray(scale * result)

        return turn

    def _filters(self, regression: ModalRegression, output: int) -> list[DisturbanceFilter]:
        found = []
        for number, (record, part) in enumerate(regression.segments[output]):
            rows = np.arange(part.start, part.stop)
            seen = Observations.of([regression.times[output][part] - self.latency], [rows])
            variance = self.variances[record, output : output + 1]
            found.append(self.disturbances[output][number].filter(seen, variance))
        return found


def _by_output(
    records: Sequence[TimeRecord], regression: ModalRegression, fit: ModalFit, smoothing: Smoothing
) -> list[list[InputDisturbance]]:
    """Return what the noise on the inputs does to every output by itself, in each of its segments."""
    n_shared = regression.n_shared(len(fit.omegas))
    return [
        [
            InputDisturbance(
                regression.drives[record],
                regression.structure,
                fit.omegas,
                fit.zetas,
                found[None, :n_shared],
                np.array([records[record].output(name).exposure_s]),
                smoothing,
            )
            for record, _ in segments
        ]
        for name, segments, found in zip(
            regression.output_names, regression.segments, fit.coefficients, strict=True
        )
    ]


def _whitened(own: DisturbanceFilter, columns: FloatArray) -> FloatArray:
    result = np.array(columns, order="C")
    own.whiten([result])
    return result
