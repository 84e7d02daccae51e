"""Refinement of poles, residues and residual terms by variable projection, with standard deviations.

The poles of a stabilisation chart come from a linearised error and a discrete-time model, and carry
the bias of both.  Here the response itself is fitted,

    H_oi = s^d [ sum_r A_oir / (s - p_r) + conj(A_oir) / (s - conj(p_r)) + U_oi + L_oi / s^2 ]

with d = 0, 1, 2 for receptance, mobility and accelerance, by Levenberg-Marquardt on the poles with
residues and residual terms (what modes above and below the band add) solved linearly.  Without
noise the truth comes back to rounding; with it, the estimate is that of maximum likelihood for
the variances given, or for an unknown level at every pair of output and input.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import finite_row
from beam_ident.data.bandwidth import Band
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.prior import Prior
from beam_ident.data.stored_form import read, require_shapes, written
from beam_ident.errors import EstimationError
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.mode_values import ModeValues
from beam_ident.modal.regression import ClockState
from beam_ident.modal.stacked_regression import ColumnBasis, Columns, Part, StackedRegression
from beam_ident.modal_analysis.shapes import modal_assurance, normalised, phase_collinearity
from beam_ident.modal_analysis.stabilisation import ResponseForm, StabilisationChart, checked_form
from beam_ident.modal_estimation.dependent_lines import from_common_noise, from_neighbours
from beam_ident.modal_estimation.mode_gates import mode_complaint, mode_significance
from beam_ident.modal_estimation.variable_projection import designs, fit_modes
from beam_ident.noise.line_misfit import UNKNOWN_NOISE, LineMisfit, weighting_loss
from beam_ident.noise.line_weights import line_weights, stacked_values
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.sensing.line_causes import FittedLines, line_causes
from beam_ident.summary import SummarisedModes, SummaryPart, modes_table, result_parts

SCHEMA = 2

_ITERATIONS = 60
_ALIKE = 1e-6  # chance below which residuals are called alike
_UNCERTAIN = 0.3  # relative standard deviation of a damping ratio beyond which it says little


@dataclass(frozen=True, eq=False, repr=False)
class ModalAnalysis(SummarisedModes, ModeValues):
    """Modes of a structure from its frequency responses.

    Attributes
    ----------
    record : FrequencyRecord
    form : {"receptance", "mobility", "accelerance"}
    natural_frequencies, natural_frequency_sd : ndarray, shape (n_modes,) -- [rad/s]
    damping_ratios, damping_ratio_sd : ndarray, shape (n_modes,)
    covariance : ndarray, shape (2 n_modes, 2 n_modes) -- of frequencies and damping ratios
    residues : complex ndarray, shape (n_outputs, n_inputs, n_modes)
        A in ``A / (s - p)``, of the receptance.
    residue_sd : ndarray, shape (n_outputs, n_inputs, n_modes)
        Of the complex value, both parts together.
    upper_terms, lower_terms : ndarray, shape (n_outputs, n_inputs)
        U and L: stiffness of the modes above the band, inertia of those below.
    shapes : complex ndarray, shape (n_outputs, n_modes)
        Mode shapes at the outputs, their largest point 1.
    participation : complex ndarray, shape (n_inputs, n_modes)
        So that ``residues`` is nearly ``shapes participation^T``.
    rank_one : ndarray, shape (n_modes,)
        Share of the residue matrix that one shape and one participation explain: 1 for a mode,
        less where noise or a second mode at the same place is in it.
    modelled : complex ndarray, shape (n_lines, n_outputs, n_inputs)
    misfit : LineMisfit
    noise_sd : ndarray, shape (n_outputs, n_inputs) -- of the complex response, root mean square over the lines
    converged, reason, iterations
        How the fit ended.
    warnings : tuple of str
    """

    record: FrequencyRecord
    form: ResponseForm
    natural_frequencies: FloatArray
    natural_frequency_sd: FloatArray
    damping_ratios: FloatArray
    damping_ratio_sd: FloatArray
    covariance: FloatArray
    residues: ComplexArray
    residue_sd: FloatArray
    upper_terms: FloatArray
    lower_terms: FloatArray
    shapes: ComplexArray
    participation: ComplexArray
    rank_one: FloatArray
    modelled: ComplexArray
    misfit: LineMisfit
    noise_sd: FloatArray
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        table = modes_table(*self.modes())
        return [table, *result_parts(self, (), ())]

    @property
    def residuals(self) -> ComplexArray:
        """Responses less what the modes say, shape (n_lines, n_outputs, n_inputs)."""
        return np.asarray(self.record.response - self.modelled)

    @property
    def assurance(self) -> FloatArray:
        """Modal assurance criterion of the shapes among themselves, shape (n_modes, n_modes)."""
        return modal_assurance(self.shapes)

    @property
    def collinearity(self) -> FloatArray:
        """Modal phase collinearity of the shapes, shape (n_modes,)."""
        return phase_collinearity(self.shapes)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "modal_analysis", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> ModalAnalysis:
        """Rebuild what ``to_dict`` wrote.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or entries that do not agree.
        """
        found = read(ModalAnalysis, data, "modal_analysis", SCHEMA)
        n, (n_lines, m, p) = len(found.natural_frequencies), found.record.response.shape
        modal = ("natural_frequency_sd", "damping_ratios", "damping_ratio_sd", "rank_one")
        pairs = ("upper_terms", "lower_terms", "noise_sd")
        shapes = {"covariance": (2 * n, 2 * n), "residues": (m, p, n), "residue_sd": (m, p, n)}
        shapes |= {"shapes": (m, n), "participation": (p, n), "modelled": (n_lines, m, p)}
        shapes |= {**dict.fromkeys(modal, (n,)), **dict.fromkeys(pairs, (m, p))}
        require_shapes("modal analysis", found, shapes)
        return found


class _ResidueBasis(ColumnBasis):
    """Columns ``s^d / d(s)`` and ``s^(d+1) / (omega d(s))`` of every mode, and the residual terms."""

    def __init__(
        self, record: FrequencyRecord, differentiations: int, has_upper: bool, has_lower: bool
    ) -> None:
        self.s = record.s
        self.front = self.s**differentiations
        parts = []
        if has_upper:
            parts.append(self.front)
        if has_lower:
            parts.append(self.front / self.s**2)
        fixed = np.stack(parts, axis=1) if parts else np.zeros((len(self.s), 0), dtype=np.complex128)
        real = np.concatenate([fixed.real, fixed.imag])
        self._fixed = Columns(real, real, real)

    def fixed(self, latency: float) -> Columns:
        """Return the residual terms."""
        del latency
        return self._fixed

    def modal(self, omega: float, zeta: float, latency: float) -> Columns:
        """Return the two columns of a mode with their derivatives."""
        del latency
        s = self.s
        inverse = 1.0 / (s * (s + 2.0 * zeta * omega) + omega**2)
        first = self.front * inverse
        second = first * s / omega
        falling = -inverse * (2.0 * zeta * omega * s + 2.0 * omega**2)
        widening = -inverse * (2.0 * omega * s)
        found = [
            np.stack([first, second], axis=1),
            np.stack([first * falling, second * (falling - 1.0)], axis=1),
            np.stack([first * widening, second * widening], axis=1),
        ]
        return Columns(*(np.concatenate([part.real, part.imag]) for part in found))


@on_one_thread
def analyse_modes(
    chart: StabilisationChart,
    natural_frequencies_hz: Sequence[float] | FloatArray | None = None,
    has_upper: bool = True,
    has_lower: bool = True,
) -> ModalAnalysis:
    """Refine the modes of a stabilisation chart and give them shapes and standard deviations.

    Parameters
    ----------
    chart : StabilisationChart
    natural_frequencies_hz : sequence of float or None
        Which modes to keep, by rough frequency [Hz]; None takes the chart's choice.
    has_upper, has_lower : bool
        Whether modes above and below the band are given residual terms.

    Raises
    ------
    EstimationError
        No mode on the chart, a frequency at which it has no pole, or fewer lines than unknowns.

    Notes
    -----
    Residues of different pairs of output and input are free, also where one shape and one
    participation should make them all: ``rank_one`` tests that instead of assuming it.
    """
    if not isinstance(chart, StabilisationChart):
        raise EstimationError(
            f"chart is a {type(chart).__name__}; expected what stabilisation_chart() returns"
        )
    omegas, zetas = _start(chart, natural_frequencies_hz)
    record = chart.record
    n_unknown = 2 * len(omegas) + 2 * len(omegas) + int(has_upper) + int(has_lower)
    if 2 * record.n_lines < n_unknown + 2:
        raise EstimationError(
            f"{record.n_lines} lines for {len(omegas)} modes; measure more lines or keep fewer modes"
        )
    basis = _ResidueBasis(record, checked_form(chart.form), has_upper, has_lower)
    pairs = [(j, i) for j in range(record.n_outputs) for i in range(record.n_inputs)]
    outputs = [
        [Part(0, stacked_values(record.response[:, j, i]), line_weights(record, j, i))] for j, i in pairs
    ]
    problem = StackedRegression([basis], outputs, record.variance is not None)
    hertz = record.frequencies_hz
    band = Band(float(hertz[0]), float(hertz[-1]), True)
    fit, refused = _credible(problem, omegas, zetas, band, record)
    return _result(chart, problem, fit, has_upper, has_lower, refused)


def _start(
    chart: StabilisationChart, wanted_hz: Sequence[float] | FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    if wanted_hz is None:
        if not len(chart.natural_frequencies):
            raise EstimationError(
                "the stabilisation chart chose no mode; raise max_order, loosen the criteria, or name the frequencies"
            )
        return chart.natural_frequencies, chart.damping_ratios
    stable = [pole for pole in chart.poles if pole.stability > 0]
    hertzes = finite_row("natural_frequencies_hz [Hz]", wanted_hz)
    if not len(hertzes):
        raise EstimationError(
            "no natural frequency is named; give at least one, or None for the chart's choice"
        )
    omegas, zetas = [], []
    for hertz in hertzes:
        near = [p for p in stable if abs(p.natural_frequency / (2.0 * np.pi) - hertz) < 0.02 * hertz]
        if not near:
            raise EstimationError(
                f"the stabilisation chart has no stable pole within 2 % of {hertz} Hz; raise max_order or look again"
            )
        best = max(near, key=lambda p: (p.stability, p.order))
        omegas.append(best.natural_frequency)
        zetas.append(best.damping_ratio)
    return np.array(omegas), np.array(zetas)


def _result(
    chart: StabilisationChart,
    problem: StackedRegression,
    fit: ModalFit,
    has_upper: bool,
    has_lower: bool,
    refused: tuple[str, ...],
) -> ModalAnalysis:
    record = chart.record
    n, m, k = len(fit.omegas), record.n_outputs, record.n_inputs
    n_fixed = int(has_upper) + int(has_lower)
    coefficients = np.array(fit.coefficients)
    width = coefficients.shape[1]
    misfit = UNKNOWN_NOISE
    if problem.is_noise_known:
        chi_squared = float(sum(e @ e for e in fit.residuals))
        misfit = LineMisfit.of(
            chi_squared, problem.n_samples, fit.n_parameters, m * k, record.degrees_of_freedom
        )
    inflation = weighting_loss(record.degrees_of_freedom) * misfit.inflation
    fit = dataclasses.replace(fit, covariance=fit.covariance * inflation)
    covariance = fit.pole_covariance
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    residues, residue_sd = np.empty((m * k, n), dtype=np.complex128), np.empty((m * k, n))
    for pair, found in enumerate(coefficients):
        for mode in range(n):
            first = n_fixed + 2 * mode
            a, b = found[first : first + 2]
            places = [mode, n + mode, 2 * n + pair * width + first, 2 * n + pair * width + first + 1]
            value, gradient = _residue(fit.omegas[mode], fit.zetas[mode], a, b)
            residues[pair, mode] = value
            spread = fit.covariance[np.ix_(places, places)]
            residue_sd[pair, mode] = math.sqrt(
                max(float(np.real(gradient @ spread @ np.conj(gradient))), 0.0)
            )
    of_pairs = residues.reshape(m, k, n)
    shapes, participation, rank_one = (
        np.empty((m, n), dtype=np.complex128),
        np.empty((k, n), complex),
        np.empty(n),
    )
    for mode in range(n):
        left, size, _ = np.linalg.svd(of_pairs[:, :, mode])
        shape = normalised(left[:, 0])[:, 0]
        shapes[:, mode] = shape
        participation[:, mode] = np.conj(shape) @ of_pairs[:, :, mode] / float(np.sum(np.abs(shape) ** 2))
        rank_one[mode] = size[0] ** 2 / np.sum(size**2)
    fixed = coefficients[:, :n_fixed]
    zeros = np.zeros((m, k))
    (total,) = problem.modelled(fit)
    lines = record.n_lines
    modelled = (total[:lines] + 1j * total[lines:]).reshape(lines, m, k)
    seen = FittedLines.of(record, total, fit.residuals, designs(problem, fit, Prior(), Prior()))
    causes = line_causes(seen, problem.is_noise_known)
    left_over = np.where(np.isfinite(record.response), record.response - modelled, 0.0)
    return ModalAnalysis(
        record=record,
        form=chart.form,
        natural_frequencies=fit.omegas,
        natural_frequency_sd=sd[:n],
        damping_ratios=fit.zetas,
        damping_ratio_sd=sd[n:],
        covariance=covariance,
        residues=of_pairs,
        residue_sd=residue_sd.reshape(m, k, n),
        upper_terms=fixed[:, 0].reshape(m, k) if has_upper else zeros,
        lower_terms=fixed[:, -1].reshape(m, k) if has_lower else zeros,
        shapes=shapes,
        participation=participation,
        rank_one=rank_one,
        modelled=modelled,
        misfit=misfit,
        noise_sd=np.sqrt(np.mean(np.abs(left_over) ** 2, axis=0)),
        converged=fit.converged,
        reason=fit.reason,
        iterations=fit.iterations,
        warnings=(*record.warnings, *refused, *_warnings(fit, misfit, sd, _likeness(fit, lines)), *causes),
    )


def _credible(
    problem: StackedRegression,
    omegas: FloatArray,
    zetas: FloatArray,
    band: Band,
    record: FrequencyRecord,
) -> tuple[ModalFit, tuple[str, ...]]:
    """Return the refined fit of the modes that pass the gates of all estimators, and what was left out.

    Raises
    ------
    EstimationError
        No mode passes them.
    """
    refused: list[str] = []
    while True:
        plain = fit_modes(problem, omegas, zetas, ClockState(), Prior(), Prior(), _ITERATIONS)
        fit = _with_dependent_errors(problem, plain, record)
        modes = range(len(fit.omegas))
        complaints = {mode: said for mode in modes if (said := mode_complaint(fit, problem, mode, band))}
        if not complaints:
            return fit, tuple(refused)
        worst = min(complaints, key=lambda mode: mode_significance(fit, problem, mode, band)[0])
        refused.append(f"a mode of the chart was left out: {complaints[worst]}")
        if len(fit.omegas) == 1:
            raise EstimationError(
                f"no mode can be trusted ({complaints[worst]}). Measure more lines, or other bands"
            )
        omegas, zetas = np.delete(fit.omegas, worst), np.delete(fit.zetas, worst)


def _with_dependent_errors(problem: StackedRegression, fit: ModalFit, record: FrequencyRecord) -> ModalFit:
    """Return the fit with what pairs, and neighbouring lines, have in common in its covariance."""
    jacobians = designs(problem, fit, Prior(), Prior())
    more = from_common_noise(fit, jacobians, [record]) + from_neighbours(fit, jacobians, [record])
    return dataclasses.replace(fit, covariance=fit.covariance + more)


def _residue(omega: float, zeta: float, a: float, b: float) -> tuple[complex, ComplexArray]:
    """Return ``A`` of ``(a + b s / omega) / d(s)`` and its derivatives by (log omega, zeta, a, b)."""
    root = math.sqrt(1.0 - zeta**2)
    unit = complex(-zeta, root)
    turned = complex(-1.0, -zeta / root)
    bottom = 2j * omega * root
    value = (a + b * unit) / bottom
    by_zeta = b * turned / bottom + value * zeta / root**2
    return value, np.array([-value, by_zeta, 1.0 / bottom, unit / bottom])


def _likeness(fit: ModalFit, n_lines: int) -> float:
    """Return the chance that independent errors are as alike from line to line as the residuals are.

    Notes
    -----
    ``n |r|^2`` with r the correlation of neighbouring lines is exponentially distributed for each of the
    pairs, so that twice the sum over N pairs is chi-squared with 2 N degrees of freedom.
    """
    total = 0.0
    for residuals in fit.residuals:
        values = residuals[:n_lines] + 1j * residuals[n_lines:]
        power = float(np.sum(np.abs(values) ** 2))
        total += n_lines * abs(np.vdot(values[:-1], values[1:])) ** 2 / max(power**2, 1e-300)
    return float(chi_squared_sf(2 * len(fit.residuals), 2.0 * total))


def _warnings(fit: ModalFit, misfit: LineMisfit, sd: FloatArray, likeness: float) -> tuple[str, ...]:
    found = [misfit.warning] if misfit.warning else []
    if likeness < _ALIKE:
        found.append(
            "the residuals of neighbouring lines are alike: modes are missing, or the noise is not independent from "
            "line to line. The standard deviations count it as noise"
        )
    if not fit.converged:
        found.append(f"the refinement did not converge: {fit.reason}")
    n = len(fit.omegas)
    for omega, zeta, spread in zip(fit.omegas, fit.zetas, sd[n:], strict=True):
        if spread > _UNCERTAIN * zeta:
            found.append(
                f"the damping ratio at {omega / (2.0 * np.pi):.5g} Hz is only known as {zeta:.2g} +- {spread:.1g}"
            )
    return tuple(found)
