"""Maximum-likelihood fit of a modal model to frequency data.

Every line weighs by its own noise, so that the estimate reaches the Cramer-Rao bound that
the lines allow (Pintelon and Schoukens 2012, the sample maximum-likelihood
estimator).  Poles are common to all outputs and records; gains, residues and residual
terms are solved linearly for any poles.  Holds, exposures and folded lines enter through
the records' ``Folding``, so that a response measured through a zero-order hold, or above half
the camera's rate, is compared with what the model would show there.

Nothing has to be guessed: modes are looked for one at a time over the measured band and
refined together.  Without a given number of modes the Bayesian information criterion
decides, with the same gates as in ``beam_ident.identify``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.data.argument_checks import require_frequency_record, require_responses
from beam_ident.data.bandwidth import Band
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.prior import Prior
from beam_ident.errors import EstimationError
from beam_ident.modal.fit import ModalFit, fitted_model
from beam_ident.modal.identification_result import FrequencyDomainResult
from beam_ident.modal.line_basis import LineBasis
from beam_ident.modal.stacked_regression import Part, StackedRegression
from beam_ident.modal.structure import ModalStructure, StructureKind, kinds_by_units
from beam_ident.modal_estimation.dependent_lines import from_common_noise, from_neighbours, rows_by_record
from beam_ident.modal_estimation.free_base import with_kind_of
from beam_ident.modal_estimation.mode_gates import mode_warnings
from beam_ident.modal_estimation.mode_scan import Candidate, Family, rivals
from beam_ident.modal_estimation.mode_search import MAX_MODES, ModeSearch, Weighed, checked_limit
from beam_ident.modal_estimation.variable_projection import designs
from beam_ident.noise.line_misfit import UNKNOWN_NOISE, LineMisfit, weighting_loss
from beam_ident.noise.line_weights import line_weights, stacked_values
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.sensing.line_causes import FittedLines, line_causes

_EVENLY, _STANDING_OUT = 24, 16
_EXCITED_IMAGE = 1e-2
_SCAN_DAMPING = (0.002, 0.01, 0.05, 0.25)


@on_one_thread
def fit_frequency_modes(
    records: FrequencyRecord | Sequence[FrequencyRecord],
    structure: StructureKind | ModalStructure | None = None,
    n_modes: int | None = None,
    latency: Prior | None = None,
    max_modes: int = MAX_MODES,
) -> FrequencyDomainResult:
    """Fit a modal model with common poles to frequency data, without hints.

    Parameters
    ----------
    records : FrequencyRecord or a sequence of them
        One input and the same outputs in each.
    structure : str, ModalStructure or None
        Where the modes stand; offsets, ramps and free responses have no place here.  None goes by the units of the
        records, as in ``identify``.
    n_modes : int or None -- None lets the Bayesian information criterion decide
    latency : Prior or None
        How late the outputs' stamps are [s]; None takes 0 as known.
    max_modes : int

    Raises
    ------
    EstimationError
        No record, several inputs, different outputs, fewer lines than unknowns, or no mode found.

    Notes
    -----
    The outputs' errors may depend on each other (noise on a common input does that): weights
    are those of each output alone, the stated covariance is that of this estimator under the
    full covariance of the record.
    """
    data = tuple(records) if isinstance(records, list | tuple) else (records,)
    for record in data:
        require_frequency_record(record)
    if latency is not None and not isinstance(latency, Prior):
        raise EstimationError(f"latency is {latency!r}; expected a Prior(mean, sd) in s, or None")
    if structure is None and data:
        units = (
            [unit for one in data for unit in one.input_units],
            [unit for one in data for unit in one.output_units],
        )
        return with_kind_of(
            kinds_by_units(*units), lambda kind: fit_frequency_modes(data, kind, n_modes, latency, max_modes)
        )
    form = structure if isinstance(structure, ModalStructure) else ModalStructure(structure or "base_motion")
    prior = Prior(0.0, 0.0) if latency is None else latency
    bases = _bases(data, form, prior)
    checked_limit(n_modes, max_modes)
    lines = sum(record.n_lines for record in data)
    if n_modes is not None and 2 * lines < 4 * n_modes + 4:
        raise EstimationError(
            f"{lines} lines for {n_modes} modes; a fit needs at least {2 * n_modes + 2}. Ask for fewer modes"
        )
    return _LineSearch(data, bases, form, prior).result(n_modes, max_modes)


def _bases(data: tuple[FrequencyRecord, ...], structure: ModalStructure, latency: Prior) -> list[LineBasis]:
    """Return the columns of every record, or raise EstimationError for records that do not go together."""
    if not data:
        raise EstimationError("no frequency record to fit; give at least one")
    first = data[0]
    for record in data:
        if record.n_inputs != 1:
            raise EstimationError(
                f"frequency record {record.name!r} has the inputs {', '.join(record.input_names)}; a modal model has "
                "one. Use select(), or beam_ident.modal_analysis for several"
            )
        if record.output_names != first.output_names:
            raise EstimationError(
                f"frequency records {first.name!r} and {record.name!r} have different outputs; use select() first"
            )
        require_responses(record)
    known = [record.variance is not None for record in data]
    if any(known) and not all(known):
        raise EstimationError(
            "some frequency records have variances and others none; give all of them theirs, or none"
        )
    return [LineBasis(record, structure, latency.is_free) for record in data]


class _LineSearch(ModeSearch[StackedRegression]):
    """The search in lines: evenly over the band, and where the residuals stand out.

    What stands out at a line may be a mode at one of its images: these are a family of their own.
    """

    def __init__(
        self,
        data: tuple[FrequencyRecord, ...],
        bases: Sequence[LineBasis],
        structure: ModalStructure,
        latency: Prior,
    ) -> None:
        self.data, self.bases, self.structure = data, bases, structure
        own = np.unique(np.concatenate([record.omegas for record in data]))
        excited = self._images(slice(None))
        self.even = [_thinned(own), _thinned(excited)]
        # Lines that share a bin with a stronger one were excited too.
        low = min(own[0], np.min(excited, initial=math.inf)) / (2.0 * np.pi)
        high = max(own[-1], np.max(excited, initial=0.0)) / (2.0 * np.pi)
        outputs = [
            [
                Part(number, stacked_values(record.response[:, j, 0]), line_weights(record, j, 0))
                for number, record in enumerate(data)
            ]
            for j in range(data[0].n_outputs)
        ]
        problem = StackedRegression(bases, outputs, data[0].variance is not None)
        super().__init__(problem, Band(float(low), float(high), True), latency, Prior(), structure.has_direct)

    def _images(self, lines: slice | IndexArray, record: int | None = None) -> FloatArray:
        """Return frequencies of images of some lines that were excited and that a scan sees [rad/s]."""
        found = [np.zeros(0)]
        for k, (own, basis) in enumerate(zip(self.data, self.bases, strict=True)):
            if own.folding is not None and record in (None, k):
                seen = own.folding.omegas[lines][:, basis.seen_images]
                excited = np.abs(own.folding.weights[lines][:, basis.seen_images]) > _EXCITED_IMAGE
                found.append(np.abs(seen[excited]))
        return np.unique(np.concatenate(found))

    def propose(self, fit: ModalFit, excluded: Sequence[float]) -> list[Candidate]:
        """Return the best place among the lines, and among their images."""
        first, own, images = 0, [self.even[0]], [self.even[1]]
        for k, record in enumerate(self.data):
            n = record.n_lines
            power = sum(e[first : first + n] ** 2 + e[first + n : first + 2 * n] ** 2 for e in fit.residuals)
            first += 2 * n
            lines = np.argsort(-np.asarray(power))[:_STANDING_OUT]
            own.append(record.omegas[lines])
            images.append(self._images(lines, k))
        frequencies = [np.unique(np.concatenate(parts)) for parts in (own, images)]
        return rivals(self.problem, fit, [_crossed(w) for w in frequencies if len(w)], excluded)

    def _bic(self, fit: ModalFit) -> float:
        """Return the information criterion of lines that share errors.

        Notes
        -----
        What is taken for a mode gains as many times more by chance as errors are shared: the likelihood counts that
        much less, and so do the lines.
        """
        shared = max(record.shared_lines for record in self.data)
        return 2.0 * fit.cost / shared + fit.n_parameters * math.log(
            max(self.problem.n_samples / shared, math.e)
        )

    def _target(self, current: ModalFit, n_modes: int | None) -> float:
        if n_modes is not None:
            return math.inf
        shared = max(record.shared_lines for record in self.data)
        price = self.problem.n_parameters_of_a_mode * math.log(max(self.problem.n_samples / shared, math.e))
        return current.cost - 0.5 * shared * price

    def weighed(self, fit: ModalFit) -> Weighed[StackedRegression]:
        """Return the fit with the covariance of this estimator under the full covariance of the records.

        Every line weighs by its own noise from the start; what weights of few periods lose, and what errors of
        several outputs have in common, widens the intervals.
        """
        jacobians = designs(self.problem, fit, self.latency, self.clock_rate)
        covariance = fit.covariance + from_common_noise(fit, jacobians, self.data)
        covariance = covariance * weighting_loss(self._freedom) + from_neighbours(fit, jacobians, self.data)
        return Weighed(dataclasses.replace(fit, covariance=covariance), self.plain, self.plain)

    @property
    def _freedom(self) -> float:
        return min(record.degrees_of_freedom for record in self.data)

    def _lines(self, fit: ModalFit) -> list[FittedLines]:
        """Return what a fit leaves of every output in each record."""
        found = []
        jacobians = designs(self.problem, fit, self.latency, self.clock_rate)
        parts = zip(rows_by_record(self.data), self.problem.modelled(fit), strict=True)
        for (record, rows), modelled in parts:
            left, by_parameters = ([own[rows] for own in whole] for whole in (fit.residuals, jacobians))
            found += FittedLines.of(record, modelled, left, by_parameters)
        return found

    def result(self, n_modes: int | None, max_modes: int) -> FrequencyDomainResult:
        """Search, and return what was found."""
        fit = self.run(n_modes, max_modes).fit
        problem, first = self.problem, self.data[0]
        misfit = UNKNOWN_NOISE
        if problem.is_noise_known:
            chi_squared = float(sum(e @ e for e in fit.residuals))
            m = len(fit.coefficients)
            misfit = LineMisfit.of(chi_squared, problem.n_samples, fit.n_parameters, m, self._freedom)
        fit = dataclasses.replace(fit, covariance=fit.covariance * misfit.inflation)
        warnings = [misfit.warning] if misfit.warning else []
        warnings += line_causes(self._lines(fit), problem.is_noise_known)
        warnings += list(dict.fromkeys(said for record in self.data for said in record.fit_warnings))
        warnings += mode_warnings(fit, problem, self.band)
        if first.variance is not None:
            noise = np.sqrt(np.nanmean(first.variance[:, :, 0], axis=0))
        else:
            weights = np.array([line_weights(first, j, 0)[0] for j in range(first.n_outputs)])
            noise = math.sqrt(2.0) * fit.sigmas / np.maximum(weights, 1e-300)
        names = tuple(first.output_names)
        return FrequencyDomainResult(
            model=fitted_model(
                fit, self.structure, (first.input_names[0],), names, (self.latency.is_free, False), noise
            ),
            records=self.data,
            modelled=tuple(
                (rows[: len(rows) // 2] + 1j * rows[len(rows) // 2 :])[:, :, None]
                for rows in problem.modelled(fit)
            ),
            orders=self.orders,
            misfit=misfit,
            converged=fit.converged,
            reason=fit.reason,
            iterations=fit.iterations,
            warnings=tuple(warnings),
        )


def _crossed(omegas: FloatArray) -> Family:
    """Return every frequency with every damping ratio of the scan."""
    grid, damping = np.meshgrid(omegas, np.array(_SCAN_DAMPING), indexing="ij")
    return grid.ravel(), damping.ravel()


def _thinned(omegas: FloatArray) -> FloatArray:
    """Return some of many frequencies, evenly."""
    return omegas[np.linspace(0, len(omegas) - 1, min(_EVENLY, len(omegas))).astype(np.intp)]
