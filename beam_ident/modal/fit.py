"""The parameters of a fit with their covariance, and the modal model that they make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ClockState
from beam_ident.modal.structure import ModalStructure


@dataclass(frozen=True, eq=False)
class ModalFit:
    """The estimate and how it came about.

    Attributes
    ----------
    omegas, zetas : ndarray, shape (n_modes,)
        Natural frequencies [rad/s], in rising order, and damping ratios.
    clock : ClockState
    coefficients : tuple of ndarray -- linear parameters of every output
    mode_columns : tuple of ndarray, each (n_modes, n_columns)
        Which of an output's coefficients belong to each mode.
    residuals : tuple of ndarray -- measured minus modelled, per output, weighed as the data are
    sigmas : ndarray, shape (n_outputs,) -- noise standard deviations; 1 where the weights say it all
    cost : float -- concentrated negative log-likelihood (up to a constant)
    covariance : ndarray
        Of (log omega.., zeta.., free clock parameters.., linear parameters of output 1, ..).
        Under the noise as it is: autocorrelated where the residuals are, and after the last
        weighing with what noise on the input contributes.
    information_condition : float
        Condition of the scaled information matrix of poles and clock.
    input_noise_shares : ndarray, shape (n_outputs,)
        Share of each output's noise variance that noise on the input makes up.
    rank_deficient : tuple of int -- outputs whose linear columns depend on each other
    noises : tuple of tuple of str
        Of every output what its noise was taken for in every record, empty for white; none with equal weights.
    spreads : tuple of ndarray
        Of every output the noise of its rows over that of all; none where it is the same for all.
    innovations : tuple of ndarray
        Of every output what the weights make of its residuals: white, and no output's that of another, where the
        noise is what it was taken for; none with equal weights.
    """

    omegas: FloatArray
    zetas: FloatArray
    clock: ClockState
    coefficients: tuple[FloatArray, ...]
    mode_columns: tuple[IndexArray, ...]
    residuals: tuple[FloatArray, ...]
    sigmas: FloatArray
    cost: float
    covariance: FloatArray
    information_condition: float
    input_noise_shares: FloatArray
    rank_deficient: tuple[int, ...]
    converged: bool
    reason: str
    iterations: int
    noises: tuple[tuple[str, ...], ...] = ()
    spreads: tuple[FloatArray, ...] = ()
    innovations: tuple[FloatArray, ...] = ()

    @property
    def n_parameters(self) -> int:
        """Number of estimated parameters."""
        return len(self.covariance)

    @property
    def n_theta(self) -> int:
        """Number of nonlinear parameters: two for every mode, and those of the clock that are free."""
        return self.n_parameters - sum(len(found) for found in self.coefficients)

    @property
    def pole_covariance(self) -> FloatArray:
        """Covariance of natural frequencies [rad/s] and damping ratios, shape (2 n_modes, 2 n_modes)."""
        n = len(self.omegas)
        scale = np.concatenate([self.omegas, np.ones(n)])
        return np.asarray(self.covariance[: 2 * n, : 2 * n] * np.outer(scale, scale))


def fitted_model(
    fit: ModalFit,
    structure: ModalStructure,
    input_names: tuple[str, ...],
    output_names: tuple[str, ...],
    clock_is_free: tuple[bool, bool],
    noise_sd: FloatArray | None = None,
) -> ModalModel:
    """Collect the parameters of a fit, leaving out offsets, ramps and free responses.

    Parameters
    ----------
    fit : ModalFit
        Its linear parameters begin with direct gain and residual term of every input, then the residues of all
        modes under each input.
    structure : ModalStructure
    input_names : tuple of str
    output_names : tuple of str
    clock_is_free : tuple of bool -- whether latency and clock rate were estimated
    noise_sd : ndarray or None, shape (n_outputs,) -- None takes the fit's own
    """
    n, m, k = len(fit.omegas), len(output_names), len(input_names)
    # Where each parameter of the model stands among those of the fit; -1 for one that was not estimated.
    source: list[int] = list(range(2 * n))
    place = 2 * n
    for is_free in clock_is_free:
        source.append(place if is_free else -1)
        place += int(is_free)
    gains, residual_terms, residues = np.zeros((m, k)), np.zeros((m, k)), np.zeros((m, k, n))
    terms = ((structure.has_direct, gains), (structure.has_residual, residual_terms))
    n_terms = sum(is_there for is_there, _ in terms)
    for j, found in enumerate(fit.coefficients):
        for drive in range(k):
            column = drive * n_terms
            for is_there, values in terms:
                source.append(place + column if is_there else -1)
                if is_there:
                    values[j, drive] = found[column]
                    column += 1
            column = k * n_terms + drive * n
            residues[j, drive] = found[column : column + n]
            source.extend(range(place + column, place + column + n))
        place += len(found)
    if k == 1:
        gains, residual_terms, residues = gains[:, 0], residual_terms[:, 0], residues[:, 0]
    index = np.array(source)
    covariance = fit.covariance[np.ix_(index, index)]
    covariance[index < 0, :] = 0.0
    covariance[:, index < 0] = 0.0
    # The fit's parameter is the logarithm of a frequency, the model's the frequency.
    scale = np.ones(len(index))
    scale[:n] = fit.omegas
    return ModalModel(
        structure=structure.kind,
        input_name=input_names[0],
        output_names=output_names,
        natural_frequencies=fit.omegas,
        damping_ratios=fit.zetas,
        residues=residues,
        residual_terms=residual_terms,
        gains=gains,
        latency=fit.clock.latency,
        clock_rate=fit.clock.rate,
        covariance=covariance * np.outer(scale, scale),
        noise_sd=fit.sigmas if noise_sd is None else noise_sd,
        further_inputs=input_names[1:],
    )
