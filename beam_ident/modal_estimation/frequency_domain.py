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

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import require_frequency_record, require_whole_number
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.prior import Prior
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure, StructureKind
from beam_ident.modal_estimation.mode_search import Family, PoleOrder, mode_warnings, search_modes
from beam_ident.modal_estimation.pole_projection import Columns, Part, PoleFit, PoleProblem
from beam_ident.noise.line_misfit import UNKNOWN_NOISE, LineMisfit, weighting_loss
from beam_ident.numerics.blas_threads import on_one_thread

MAX_MODES = 10
_MOST_MODES = 40

_EVENLY, _STANDING_OUT = 24, 16
_EXCITED_IMAGE = 1e-2
_SCAN_DAMPING = (0.002, 0.01, 0.05, 0.25)
_SCAN_IMAGE = 0.05
_LARGEST = 1e60  # squares of squares must not overflow
_EDGE = 1.1  # how far outside the measured band a pole may stand


@dataclass(frozen=True, eq=False)
class FrequencyDomainResult:
    """A modal model from frequency data.

    Attributes
    ----------
    model : ModalModel
    records : tuple of FrequencyRecord
    modelled : tuple of complex ndarray, each (n_lines, n_outputs, 1)
        What the model says at the lines, foldings included.
    orders : tuple of PoleOrder
    misfit : LineMisfit
    converged, reason, iterations
        How the last fit ended.
    warnings : tuple of str
    """

    model: ModalModel
    records: tuple[FrequencyRecord, ...]
    modelled: tuple[ComplexArray, ...]
    orders: tuple[PoleOrder, ...]
    misfit: LineMisfit
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]

    @property
    def residuals(self) -> tuple[ComplexArray, ...]:
        """Responses less what the model says, each (n_lines, n_outputs, 1); NaN where none was measured."""
        return tuple(own.response - said for own, said in zip(self.records, self.modelled, strict=True))


class LineBasis:
    """Columns of a modal structure at the lines of one record, real parts above imaginary ones.

    Parameters
    ----------
    record : FrequencyRecord
    structure : ModalStructure
    is_late : bool -- whether derivatives by the latency are wanted; they are 0 otherwise
    """

    def __init__(self, record: FrequencyRecord, structure: ModalStructure, is_late: bool = True) -> None:
        self.structure, self.is_late = structure, is_late
        self.folding = record.folding
        s: ComplexArray = np.asarray(1j * record.omegas[:, None], dtype=np.complex128)
        weights = np.ones(s.shape, dtype=np.complex128)
        self.tails: ComplexArray | None = None
        if self.folding is not None:
            s = np.concatenate([s, 1j * self.folding.omegas], axis=1)
            weights = np.concatenate([weights, self.folding.weights], axis=1)
            self.tails = self.folding.tails
            lowest = 2 - (structure.differentiations if structure.has_residual else 0)
            if not np.all(np.isfinite(self.tails[:, lowest:])):
                raise EstimationError(
                    f"frequency record {record.name!r} comes from a held input, which jumps; the structure "
                    f"{structure.kind} differentiates it. Give the input hold='cubic', or has_residual=False"
                )
        self.s, self.weights = s, weights
        self._squares = s.imag**2
        # What every mode is multiplied by, and that once more times s: a fit asks for it many hundred times.
        self._front = weights * structure.sign * s**structure.differentiations
        self._rising = self._front * s
        self._last_fixed: tuple[float, Columns] | None = None
        # A mode falls as 1/omega^2 beyond the band: far images do not move a maximum of the scan.
        reach = np.minimum(1.0, record.omegas[-1] / np.abs(s)) ** 2
        self._scanned = np.flatnonzero(np.max(np.abs(weights) * reach, axis=0) > _SCAN_IMAGE)

    @property
    def seen_images(self) -> IndexArray:
        """Places of the images, among those of the folding, that a scan counts."""
        return np.asarray(self._scanned[self._scanned > 0] - 1)

    def _with_tails(self, lines: ComplexArray, expansion: Sequence[tuple[int, float]]) -> FloatArray:
        """Return a real column: the sum over all images, and what its first terms in 1/s add for those left out."""
        if self.tails is not None:
            for power, factor in expansion:
                lines = lines + factor * self.tails[:, power + 2]
        return np.concatenate([lines.real, lines.imag])

    def _fixed_pair(self, exponent: int, factor: float, latency: float) -> list[FloatArray]:
        """Return the column ``factor s^exponent`` and its derivative by the latency, both real."""
        values = self.weights * (factor * self.s**exponent)
        if latency:
            values = values * np.exp(-self.s * latency)
        column = self._with_tails(np.sum(values, axis=1), [(-exponent, factor)])
        return [column, self._with_tails(np.sum(-self.s * values, axis=1), ())]

    def fixed(self, latency: float) -> Columns:
        """Return direct gain and residual term, where the structure has them."""
        if self._last_fixed is None or self._last_fixed[0] != latency:
            self._last_fixed = latency, self._fixed_columns(latency)
        return self._last_fixed[1]

    def _fixed_columns(self, latency: float) -> Columns:
        structure, pairs = self.structure, []
        power = structure.differentiations
        if structure.has_direct:
            pairs.append(self._fixed_pair(-2 if structure.kind == "force" else power - 2, 1.0, latency))
        if structure.has_residual:
            pairs.append(self._fixed_pair(power, structure.sign, latency))
        if not pairs:
            empty = np.zeros((2 * len(self.s), 0))
            return Columns(empty, empty, empty, empty)
        value, slope = (np.column_stack([pair[k] for pair in pairs]) for k in range(2))
        return Columns(value, value, value, slope)

    def modal(self, omega: float, zeta: float, latency: float) -> Columns:
        """Return the column of one mode with its derivatives."""
        sign, power = self.structure.sign, self.structure.differentiations
        front, rising = self._front, self._rising
        if latency:
            late = np.exp(-self.s * latency)
            front, rising = front * late, rising * late
        inverse = 1.0 / ((omega**2 - self._squares) + (2.0 * zeta * omega) * self.s)
        squared = inverse * inverse
        lines = np.einsum("li,li->l", front, inverse)
        level, slope = -np.einsum("li,li->l", front, squared), -np.einsum("li,li->l", rising, squared)
        # Powers of 1/s in front / d(s) = sign s^p (s^-2 - 2 zeta omega s^-3 + (4 zeta^2 - 1) omega^2 s^-4 ..).
        third = (4.0 * zeta**2 - 1.0) * omega**2
        terms = [(2 - power, 1.0, 0.0, 0.0)]
        if power >= 1:
            terms.append((3 - power, -2.0 * zeta * omega, -2.0 * zeta * omega, -2.0 * omega))
        if power == 2:
            terms.append((4 - power, third, 2.0 * third, 8.0 * zeta * omega**2))
        expansions = [[(term[0], sign * term[k]) for term in terms] for k in (1, 2, 3)]
        column = self._with_tails(lines, expansions[0])
        by_omega = self._with_tails(2.0 * zeta * omega * slope + 2.0 * omega**2 * level, expansions[1])
        by_zeta = self._with_tails(2.0 * omega * slope, expansions[2])
        by_latency = np.zeros_like(column)
        if self.is_late:
            by_latency = self._with_tails(-np.einsum("li,li->l", rising, inverse), ())
        return Columns(column[:, None], by_omega[:, None], by_zeta[:, None], by_latency[:, None])

    def scanned(self, omegas: FloatArray, zetas: FloatArray, latency: float) -> FloatArray:
        """Return the columns of candidate modes, the weakest images left out."""
        n = len(self.s)
        total = np.zeros((2 * n, len(omegas)))
        for column in self._scanned:
            # In real numbers: 1 / (a + jb) = (a - jb) / (a^2 + b^2).
            w = self.s[:, column, None].imag
            factor = (self._front[:, column] * np.exp(-self.s[:, column] * latency))[:, None]
            stiff, lossy = omegas**2 - w**2, w * (2.0 * zetas * omegas)
            size = stiff**2 + lossy**2
            stiff /= size
            lossy /= size
            total[:n] += factor.real * stiff + factor.imag * lossy
            total[n:] += factor.imag * stiff - factor.real * lossy
        return total[:, :, None]


def line_weights(record: FrequencyRecord, output: int, drive: int) -> FloatArray:
    """Return one over the standard deviation of real and imaginary part, 0 for missing lines.

    Without variances every line counts the same, in units of the response's own size.
    """
    values = record.response[:, output, drive]
    seen = np.isfinite(values)
    if record.variance is None:
        size = math.sqrt(float(np.mean(np.abs(values[seen]) ** 2))) if np.any(seen) else 1.0
        weights = np.full(len(values), 1.0 / max(size, 1e-300))
    else:
        variance = record.variance[:, output, drive]
        largest = float(np.max(np.abs(values[seen]), initial=0.0))
        # A variance of zero would be an infinite weight: rounding is the least there is.
        floor = max((1e-10 * largest) ** 2, 1e-300)
        weights = np.sqrt(2.0 / np.maximum(variance, floor))
    weights = np.where(seen, weights, 0.0)
    return np.concatenate([weights, weights])


def require_responses(record: FrequencyRecord) -> None:
    """Raise EstimationError where a response has no finite value, is zero at every line, or of an absurd size."""
    for j, output in enumerate(record.output_names):
        for i, drive in enumerate(record.input_names):
            values = record.response[:, j, i]
            largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
            if largest > 0.0 and not 1.0 / _LARGEST < largest < _LARGEST:
                raise EstimationError(
                    f"frequency record {record.name!r}: the response of {output!r} to {drive!r} reaches "
                    f"{largest:.3g}; expected between {1.0 / _LARGEST:g} and {_LARGEST:g}. Use other units"
                )
            if not largest > 0.0:
                what = "zero" if np.any(np.isfinite(values)) else "missing"
                raise EstimationError(
                    f"frequency record {record.name!r}: the response of {output!r} to {drive!r} is {what} at every "
                    "line; leave it out with select()"
                )


def stacked_values(values: ComplexArray) -> FloatArray:
    """Return real parts above imaginary ones, 0 where nothing was measured."""
    plain = np.where(np.isfinite(values), values, 0.0)
    return np.concatenate([plain.real, plain.imag])


@on_one_thread
def fit_frequency_modes(
    records: FrequencyRecord | Sequence[FrequencyRecord],
    structure: StructureKind | ModalStructure = "base_motion",
    n_modes: int | None = None,
    latency: Prior | None = None,
    max_modes: int = MAX_MODES,
) -> FrequencyDomainResult:
    """Fit a modal model with common poles to frequency data, without hints.

    Parameters
    ----------
    records : FrequencyRecord or a sequence of them
        One input and the same outputs in each.
    structure : str or ModalStructure
        Where the modes stand; offsets, ramps and free responses have no place here.
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
    form = structure if isinstance(structure, ModalStructure) else ModalStructure(structure)
    prior = Prior(0.0, 0.0) if latency is None else latency
    problem, bases = _problem(data, form, prior)
    limit = max_modes if n_modes is None else n_modes
    require_whole_number("max_modes" if n_modes is None else "n_modes", limit, 1, _MOST_MODES)
    lines = sum(record.n_lines for record in data)
    if n_modes is not None and 2 * lines < 4 * n_modes + 4:
        raise EstimationError(
            f"{lines} lines for {n_modes} modes; a fit needs at least {2 * n_modes + 2}. Ask for fewer modes"
        )
    proposals = _Proposals(data, bases)
    chosen, orders = search_modes(problem, proposals, proposals.band, n_modes, limit)
    if not len(chosen.omegas):
        raise EstimationError(
            f"no mode stands out of the noise between {data[0].frequencies_hz[0]:.4g} and "
            f"{data[0].frequencies_hz[-1]:.4g} Hz ({orders[-1].refused_because or 'no candidate'}). Excite more, or "
            "ask for a number of modes to see the best candidate"
        )
    return _result(problem, data, form, chosen, orders, proposals.band)


def _problem(
    data: tuple[FrequencyRecord, ...], structure: ModalStructure, latency: Prior
) -> tuple[PoleProblem, tuple[LineBasis, ...]]:
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
    blocks = tuple(
        tuple(
            Part(number, stacked_values(record.response[:, j, 0]), line_weights(record, j, 0))
            for number, record in enumerate(data)
        )
        for j in range(first.n_outputs)
    )
    bases = tuple(LineBasis(record, structure, latency.is_free) for record in data)
    return PoleProblem(bases, blocks, all(known), latency), bases


class _Proposals:
    """Where a scan looks for a further mode: evenly over the band, and where the residuals stand out.

    What stands out at a line may be a mode at one of its images: these are a family of their own.
    """

    def __init__(self, data: tuple[FrequencyRecord, ...], bases: tuple[LineBasis, ...]) -> None:
        self.data, self.bases = data, bases
        own = np.unique(np.concatenate([record.omegas for record in data]))
        everywhere = slice(None)
        excited = self._images(everywhere)
        # Lines that share a bin with a stronger one were excited too.
        top = max(float(own[-1]), float(np.max(excited, initial=0.0)))
        self.band = (float(min(own[0], np.min(excited, initial=math.inf))) / _EDGE, top * _EDGE)
        self.even = [_thinned(own), _thinned(excited)]

    def _images(self, lines: slice | IndexArray, record: int | None = None) -> FloatArray:
        """Return frequencies of images of some lines that were excited and that a scan sees [rad/s]."""
        found = [np.zeros(0)]
        for k, (own, basis) in enumerate(zip(self.data, self.bases, strict=True)):
            if own.folding is not None and record in (None, k):
                seen = own.folding.omegas[lines][:, basis.seen_images]
                excited = np.abs(own.folding.weights[lines][:, basis.seen_images]) > _EXCITED_IMAGE
                found.append(np.abs(seen[excited]))
        return np.unique(np.concatenate(found))

    def __call__(self, fit: PoleFit) -> list[Family]:
        first, own, images = 0, [self.even[0]], [self.even[1]]
        for k, record in enumerate(self.data):
            n = record.n_lines
            power = sum(e[first : first + n] ** 2 + e[first + n : first + 2 * n] ** 2 for e in fit.residuals)
            first += 2 * n
            lines = np.argsort(-np.asarray(power))[:_STANDING_OUT]
            own.append(record.omegas[lines])
            images.append(self._images(lines, k))
        families = [np.unique(np.concatenate(parts)) for parts in (own, images)]
        grids = [np.meshgrid(omegas, _SCAN_DAMPING, indexing="ij") for omegas in families if len(omegas)]
        return [(omegas.ravel(), damping.ravel()) for omegas, damping in grids]


def _thinned(omegas: FloatArray) -> FloatArray:
    """Return some of many frequencies, evenly."""
    return omegas[np.linspace(0, len(omegas) - 1, min(_EVENLY, len(omegas))).astype(np.intp)]


def _real_covariance(problem: PoleProblem, data: tuple[FrequencyRecord, ...], fit: PoleFit) -> FloatArray:
    """Return the estimator's covariance where errors of several outputs depend on each other.

    Notes
    -----
    ``C + C J^T (S - 1) J C`` with S the correlation of the weighted errors between blocks.
    For circular errors of correlation ``rho = a + jb`` the real parts correlate by a, and the
    real part of one with the imaginary part of the other by b.
    """
    covariance = fit.covariance
    m = len(fit.coefficients)
    if m < 2 or any(record.covariance is None for record in data):
        return covariance
    n_theta = covariance.shape[0] - fit.coefficients.size
    width = fit.coefficients.shape[1]
    middle = np.zeros_like(covariance)
    first = 0
    for record in data:
        n = record.n_lines
        assert record.covariance is not None
        sd = np.sqrt(np.maximum(np.einsum("lpp->lp", record.covariance).real, 1e-300))
        for i in range(m):
            for j in range(i):
                rho = record.covariance[:, i, j] / (sd[:, i] * sd[:, j])
                one, other = (fit.jacobians[k][first : first + 2 * n] for k in (i, j))
                shared = np.concatenate(
                    [
                        rho.real[:, None] * other[:n] - rho.imag[:, None] * other[n:],
                        rho.imag[:, None] * other[:n] + rho.real[:, None] * other[n:],
                    ]
                )
                part = one.T @ shared
                rows = np.concatenate([np.arange(n_theta), n_theta + i * width + np.arange(width)])
                columns = np.concatenate([np.arange(n_theta), n_theta + j * width + np.arange(width)])
                middle[np.ix_(rows, columns)] += part
                middle[np.ix_(columns, rows)] += part.T
        first += 2 * n
    return np.asarray(covariance + covariance @ middle @ covariance)


def _result(
    problem: PoleProblem,
    data: tuple[FrequencyRecord, ...],
    structure: ModalStructure,
    fit: PoleFit,
    orders: tuple[PoleOrder, ...],
    band: tuple[float, float],
) -> FrequencyDomainResult:
    freedom = min(record.degrees_of_freedom for record in data)
    covariance = _real_covariance(problem, data, fit) * weighting_loss(freedom)
    model = _model(problem, data[0], structure, fit, covariance)
    modelled = []
    for basis, record in zip(problem.bases, data, strict=True):
        columns = [basis.fixed(fit.latency).value]
        columns += [
            basis.modal(float(w), float(z), fit.latency).value
            for w, z in zip(fit.omegas, fit.zetas, strict=True)
        ]
        total = np.concatenate(columns, axis=1) @ fit.coefficients.T
        modelled.append((total[: record.n_lines] + 1j * total[record.n_lines :])[:, :, None])
    misfit = UNKNOWN_NOISE
    if problem.is_noise_known:
        chi_squared = float(sum(e @ e for e in fit.residuals))
        misfit = LineMisfit.of(chi_squared, problem.n_rows, fit.n_parameters, len(fit.coefficients), freedom)
    warnings = [misfit.warning] if misfit.warning else []
    warnings += list(dict.fromkeys(said for record in data for said in record.fit_warnings))
    warnings += mode_warnings(fit, band)
    return FrequencyDomainResult(
        model=model,
        records=data,
        modelled=tuple(modelled),
        orders=orders,
        misfit=misfit,
        converged=fit.converged,
        reason=fit.reason,
        iterations=fit.iterations,
        warnings=tuple(warnings),
    )


def _model(
    problem: PoleProblem,
    record: FrequencyRecord,
    structure: ModalStructure,
    fit: PoleFit,
    covariance: FloatArray,
) -> ModalModel:
    n, m = len(fit.omegas), len(fit.coefficients)
    n_theta = 2 * n + int(problem.latency.is_free)
    width = fit.coefficients.shape[1]
    source = [*range(2 * n), 2 * n if problem.latency.is_free else -1, -1]
    gains, residual_terms = np.zeros(m), np.zeros(m)
    for j, found in enumerate(fit.coefficients):
        place, column = n_theta + j * width, 0
        for is_there, values in ((structure.has_direct, gains), (structure.has_residual, residual_terms)):
            source.append(place + column if is_there else -1)
            if is_there:
                values[j] = found[column]
                column += 1
        source.extend(range(place + column, place + width))
    index = np.array(source)
    whole = covariance[np.ix_(index, index)]
    whole[index < 0, :] = 0.0
    whole[:, index < 0] = 0.0
    scale = np.ones(len(index))
    scale[:n] = fit.omegas
    if problem.is_noise_known and record.variance is not None:
        noise = np.sqrt(np.nanmean(record.variance[:, :, 0], axis=0))
    else:
        weights = np.array([line_weights(record, j, 0)[0] for j in range(m)])
        noise = np.sqrt(2.0 * fit.variances) / np.maximum(weights, 1e-300)
    return ModalModel(
        structure=structure.kind,
        input_name=record.input_names[0],
        output_names=tuple(record.output_names),
        natural_frequencies=fit.omegas,
        damping_ratios=fit.zetas,
        residues=fit.coefficients[:, width - n :],
        residual_terms=residual_terms,
        gains=gains,
        latency=fit.latency,
        clock_rate=0.0,
        covariance=whole * np.outer(scale, scale),
        noise_sd=noise,
    )
