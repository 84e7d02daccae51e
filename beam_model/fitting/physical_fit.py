"""From identified modes back to the beam: stiffness, damping, and what else the data determine.

Length, EI, rho, clamp compliance, tip mass and air mass all scale the natural frequencies alike to first order. What
frequencies alone determine is kappa = EI/(rho L_eff^4) and the damping; a tip mass or a clamp's compliance is fitted
only from residues too, with priors stated for it and for the markers' heights. The columns of the fit's Jacobian,
each scaled to length 1, show by their singular values whether parameters can be separated; above a stated condition
number the fit is refused, because its numbers would mean nothing.

An identified frequency is a thousand times more precise than beam theory is true. A model discrepancy, independent
from mode to mode, is therefore part of the fit (0.3 % of every frequency, 5 % of every damping ratio unless said
otherwise: two coefficients describe a real beam's losses far worse than EI describes its stiffness).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg
from scipy.optimize import least_squares

from beam_model.arrays import FloatArray
from beam_model.errors import BeamParameterError, PhysicalFitError
from beam_model.galerkin.matrices import ModalBasis
from beam_model.galerkin.model import BeamModel
from beam_model.parameters import BeamParameters, Damping, check_number

DEFAULT_DISCREPANCY = 0.003
DAMPING_DISCREPANCY = 0.05
MAX_CONDITION = 30.0

FREE = ("stiffness", "viscous", "internal", "tip_mass", "clamp_compliance")
_UNITS = {
    "stiffness": "1/s^2",
    "viscous": "N s/m^2",
    "internal": "s",
    "tip_mass": "kg",
    "clamp_compliance": "rad/(N m)",
}


@dataclass(frozen=True)
class ParameterPrior:
    """What is known beforehand: a mean and a standard deviation, in the parameter's unit."""

    mean: float
    standard_deviation: float

    def __post_init__(self) -> None:
        check_number("prior.mean", self.mean, "")
        check_number("prior.standard_deviation", self.standard_deviation, "", above=0.0)


@dataclass(frozen=True)
class ModalMeasurement:
    """Identified clamped modes, with covariances.

    Attributes
    ----------
    natural_frequencies, damping_ratios : ndarray, shape (n_modes,)
        omega [rad/s] and zeta of modes 1 to n_modes without a gap.
    covariance : ndarray, shape (2 n_modes, 2 n_modes)
        Of [natural_frequencies, damping_ratios].
    heights : ndarray, shape (n_heights,)
        Of the residues' markers [m]; empty without residues.
    residues : ndarray, shape (n_heights, n_modes)
        r of w = -s^2 sum r/(s^2 + 2 zeta omega s + omega^2) alpha.
    residue_covariance : ndarray, shape (n_heights n_modes, n_heights n_modes)
        Of ``residues`` row by row.
    """

    natural_frequencies: FloatArray
    damping_ratios: FloatArray
    covariance: FloatArray
    heights: FloatArray
    residues: FloatArray
    residue_covariance: FloatArray

    @classmethod
    def from_arrays(
        cls,
        natural_frequencies: ArrayLike,
        damping_ratios: ArrayLike,
        covariance: ArrayLike,
        heights: ArrayLike = (),
        residues: ArrayLike | None = None,
        residue_covariance: ArrayLike | None = None,
    ) -> ModalMeasurement:
        """Return a measurement after a check of its shapes, signs and covariances."""
        omega, zeta = (
            _vector("natural_frequencies", natural_frequencies),
            _vector("damping_ratios", damping_ratios),
        )
        z = _vector("heights", heights)
        if omega.size == 0 or not np.all(np.diff(omega) > 0.0) or not omega[0] > 0.0:
            raise BeamParameterError(
                "natural_frequencies", omega.tolist(), "rad/s", "positive and increasing"
            )
        if zeta.shape != omega.shape:
            raise BeamParameterError("damping_ratios", zeta.size, "", f"one for each of {omega.size} modes")
        if z.size and (residues is None or residue_covariance is None):
            raise BeamParameterError(
                "residues", residues, "", "values and covariance wherever heights are given"
            )
        shape = (z.size, omega.size)
        r = np.zeros(shape) if residues is None else np.asarray(residues, dtype=np.float64)
        if r.shape != shape:
            raise BeamParameterError("residues", r.shape, "", f"the shape {shape}: heights by modes")
        empty = np.zeros((r.size, r.size))
        return cls(
            omega,
            zeta,
            _covariance("covariance", covariance, 2 * omega.size),
            z,
            r,
            empty
            if residue_covariance is None
            else _covariance("residue_covariance", residue_covariance, r.size),
        )


@dataclass(frozen=True)
class PhysicalFit:
    """The beam that explains the measurement.

    Attributes
    ----------
    names, units : tuple of str
        The free parameters: "stiffness" is kappa = EI/(rho L_eff^4).
    values, standard_deviations : ndarray, shape (n_free,)
        In those units.
    covariance : ndarray, shape (n_free, n_free)
    inflations : ndarray, shape (n_free,)
        How many times larger each standard deviation is than if all the others were known.
    singular_values : ndarray, shape (n_free,)
        Of the Jacobian with columns scaled to length 1, the largest first.
    condition : float
        Their largest over their smallest.
    chi_squared : float
    degrees_of_freedom : int
    natural_frequencies, damping_ratios : ndarray, shape (n_modes,)
        Of the fitted beam [rad/s], [-]; damping ratios as they were before the fit where no damping is free.
    frequency_residuals : ndarray, shape (n_modes,)
        Measured over fitted frequency, less 1.
    parameters : BeamParameters
        The fitted beam; the stiffness enters through EI at the nominal length and mass.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    standard_deviations: FloatArray
    covariance: FloatArray
    inflations: FloatArray
    singular_values: FloatArray
    condition: float
    chi_squared: float
    degrees_of_freedom: int
    natural_frequencies: FloatArray
    damping_ratios: FloatArray
    frequency_residuals: FloatArray
    parameters: BeamParameters


def fit_beam(
    measurement: ModalMeasurement,
    nominal: BeamParameters,
    free: Sequence[str] = ("stiffness",),
    priors: Mapping[str, ParameterPrior] | None = None,
    *,
    height_uncertainty: float | None = None,
    model_discrepancy: float = DEFAULT_DISCREPANCY,
    damping_discrepancy: float = DAMPING_DISCREPANCY,
    max_condition: float = MAX_CONDITION,
) -> PhysicalFit:
    """Fit the free parameters of a beam to its identified modes.

    Parameters
    ----------
    measurement : ModalMeasurement
    nominal : BeamParameters
        Start and everything that is not free; prescribed damping ratios are not used.
    free : sequence of str
        Of "stiffness", "viscous", "internal", "tip_mass" and "clamp_compliance".
    priors : mapping of str to ParameterPrior, optional
        For "tip_mass" [kg] and "clamp_compliance" [rad/(N m)] demanded, for the others allowed.
    height_uncertainty : float, optional
        Standard deviation of the markers' heights [m]; demanded where residues are used. Heights are then fitted
        along with the parameters.
    model_discrepancy : float
        Standard deviation of theory against truth, relative, in every frequency.
    damping_discrepancy : float
        The same in every damping ratio.
    max_condition : float
        Above it the fit is refused.

    Raises
    ------
    PhysicalFitError
        If the data cannot separate the free parameters, or what they need is not given.
    BeamParameterError
        If an argument is out of range.

    Notes
    -----
    Gauss-Newton steps on the whitened residuals of frequencies, damping ratios (where a damping is free),
    residues and priors; standard deviations are those of the linearised fit.
    """
    priors = dict(priors or {})
    names = tuple(dict.fromkeys(free))
    _check_question(measurement, names, priors, height_uncertainty)
    check_number("model_discrepancy", model_discrepancy, "", at_least=0.0)
    check_number("damping_discrepancy", damping_discrepancy, "", at_least=0.0)
    check_number("max_condition", max_condition, "", above=1.0)
    uses_residues = measurement.heights.size > 0
    uses_damping = "viscous" in names or "internal" in names
    n, n_names = measurement.natural_frequencies.size, len(names)
    n_heights = measurement.heights.size if uses_residues else 0
    factor = _scales(nominal, measurement, names)
    length_scale = height_uncertainty if height_uncertainty is not None else 1.0

    omega_covariance = measurement.covariance[:n, :n] + np.diag(
        (model_discrepancy * measurement.natural_frequencies) ** 2
    )
    covariance = measurement.covariance.copy()
    covariance[:n, :n] = omega_covariance
    covariance[n:, n:] += np.diag((damping_discrepancy * measurement.damping_ratios) ** 2)
    whiten = linalg.cholesky(covariance if uses_damping else omega_covariance, lower=True)
    whiten_residues = linalg.cholesky(measurement.residue_covariance, lower=True) if uses_residues else None

    n_residuals = n * (2 if uses_damping else 1) + n_heights * (n + 1) + sum(name in priors for name in names)

    # Dampings and marker heights leave the modes as they are: differences in them cost no eigenproblem.
    @lru_cache(maxsize=16)
    def modes(beam: BeamParameters) -> ModalBasis:
        return ModalBasis(beam, n)

    def residuals(x: FloatArray) -> FloatArray:
        values = x[:n_names] * factor
        beam = replace(_beam(nominal, names, values), damping=nominal.damping)
        try:
            basis = modes(beam)
        except BeamParameterError:
            # A trial so soft that it buckles: worse than any beam that stands, and the search steps back from it.
            return np.full(n_residuals, 1e12)
        deviation = measurement.natural_frequencies - basis.natural_frequencies
        if uses_damping:
            off = measurement.damping_ratios - _damping_ratios(beam, basis, names, values)
            deviation = np.concatenate([deviation, off])
        parts = [linalg.solve_triangular(whiten, deviation, lower=True)]
        if whiten_residues is not None:
            heights = np.clip(measurement.heights + length_scale * x[n_names:], 0.0, nominal.length)
            residues = basis.shape(heights) * (basis.participation / basis.modal_mass)
            off = (measurement.residues - residues).ravel()
            parts += [linalg.solve_triangular(whiten_residues, off, lower=True), x[n_names:]]
        for index, name in enumerate(names):
            if name in priors:
                prior = priors[name]
                parts.append(np.array([(values[index] - prior.mean) / prior.standard_deviation]))
        return np.concatenate(parts)

    start = np.concatenate([_start(nominal, names) / factor, np.zeros(n_heights)])
    lower = np.concatenate([[_LOWER[name] for name in names], np.full(n_heights, -np.inf)])
    solution = least_squares(
        residuals,
        np.maximum(start, lower + 1e-12),
        bounds=(lower, np.inf),
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
    )
    J = np.asarray(solution.jac)
    if J.shape[0] < J.shape[1]:
        raise PhysicalFitError(
            f"{J.shape[0]} data cannot determine {J.shape[1]} parameters ({', '.join(names)}): "
            "fit fewer of them or identify more modes"
        )
    # Nuisances first, so that what is left of the parameters' columns is what the data say about them alone.
    reduced = J[:, :n_names]
    if n_heights:
        nuisance, _ = np.linalg.qr(J[:, n_names:])
        reduced = reduced - nuisance @ (nuisance.T @ reduced)
    lengths = np.linalg.norm(reduced, axis=0)
    if not np.all(lengths > 0.0):
        blind = ", ".join(name for name, length in zip(names, lengths, strict=True) if not length > 0.0)
        raise PhysicalFitError(f"the data do not depend on {blind}: leave it out of the fit or give a prior")
    _, singular, directions = np.linalg.svd(reduced / lengths, full_matrices=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else float("inf")
    if condition > max_condition:
        mix = ", ".join(f"{name} {value:+.2f}" for name, value in zip(names, directions[-1], strict=True))
        raise PhysicalFitError(
            f"the data cannot tell {' and '.join(names)} apart: condition {condition:.3g}, expected at most "
            f"{max_condition:g} (singular values {np.array2string(singular, precision=3)}, weakest direction "
            f"{mix}); fix one of them, or give residues or a tighter prior"
        )
    posterior = np.linalg.inv(reduced.T @ reduced)
    values = solution.x[:n_names] * factor
    fitted = _beam(nominal, names, values)
    basis = ModalBasis(fitted, n)
    return PhysicalFit(
        names=names,
        units=tuple(_UNITS[name] for name in names),
        values=values,
        standard_deviations=np.sqrt(np.diag(posterior)) * factor,
        covariance=posterior * np.outer(factor, factor),
        inflations=np.sqrt(np.diag(posterior)) * lengths,
        singular_values=singular,
        condition=condition,
        chi_squared=float(2.0 * solution.cost),
        degrees_of_freedom=J.shape[0] - J.shape[1],
        natural_frequencies=basis.natural_frequencies,
        damping_ratios=_damping_ratios(fitted, basis, names, values),
        frequency_residuals=measurement.natural_frequencies / basis.natural_frequencies - 1.0,
        parameters=fitted,
    )


@dataclass(frozen=True)
class Identifiability:
    """Whether one kind of experiment can separate a set of parameters.

    Attributes
    ----------
    names : tuple of str
    singular_values : ndarray, shape (n_parameters,)
        Of the Jacobian of the observables' logarithms, columns scaled to length 1.
    condition : float
        infinite if a combination of the parameters leaves no trace at all.
    inflations : ndarray, shape (n_parameters,)
        Of each standard deviation against knowing the others.
    """

    names: tuple[str, ...]
    singular_values: FloatArray
    condition: float
    inflations: FloatArray


def identifiability(
    parameters: BeamParameters,
    names: Sequence[str],
    drive: str = "motion",
    heights: ArrayLike = (),
    n_modes: int = 3,
) -> Identifiability:
    """Return how well parameters are separated, every observable known to the same relative precision.

    Parameters
    ----------
    parameters : BeamParameters
    names : sequence of str
        Of "length", "flexural_rigidity", "mass_per_length", "hub_mass", "tip_mass", "clamp_compliance".
    drive : {"motion", "force"}
        Clamped frequencies and residues; or those of the free hub, with residues in m/N and the rigid-body
        gain 1/(total mass): a *calibrated* force.
    heights : array_like
        Of markers whose residues are used [m]; empty: frequencies alone.
    n_modes : int
        How many modes are identified.
    """
    allowed = ("length", "flexural_rigidity", "mass_per_length", "hub_mass", "tip_mass", "clamp_compliance")
    for name in names:
        if name not in allowed:
            raise BeamParameterError("names", name, "", f"among {', '.join(allowed)}")
    if drive not in ("motion", "force"):
        raise BeamParameterError("drive", drive, "", '"motion" or "force"')
    z = np.array(parameters.check_heights(np.atleast_1d(np.asarray(heights, dtype=np.float64))))
    step = 1e-4
    columns = []
    for name in names:
        ends = [
            _observables(_perturbed(parameters, name, sign * step), drive, z, n_modes) for sign in (1, -1)
        ]
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    J = np.stack(columns, axis=1)
    lengths = np.linalg.norm(J, axis=0)
    safe = np.where(lengths > 1e-9, lengths, 1.0)
    scaled = np.where(lengths > 1e-9, J / safe, 0.0)
    singular = np.zeros(len(names))
    found = np.linalg.svd(scaled, compute_uv=False)
    singular[: found.size] = found
    # Differences over 2e-4 of twelve-digit observables are good to 1e-8; 1e-6 stands for nothing at all.
    if singular[-1] < 1e-6 * singular[0]:
        return Identifiability(tuple(names), singular, float("inf"), np.full(len(names), np.inf))
    inflations = np.sqrt(np.diag(np.linalg.inv(scaled.T @ scaled)))
    return Identifiability(tuple(names), singular, float(singular[0] / singular[-1]), inflations)


def _observables(parameters: BeamParameters, drive: str, heights: FloatArray, n_modes: int) -> FloatArray:
    """Return log frequencies, and residues over their largest per mode, as one vector."""
    if drive == "motion":
        model = BeamModel(parameters, n_modes)
        r = model.motion_residues(heights) if heights.size else np.zeros((0, n_modes))
        return np.concatenate([np.log(model.basis.natural_frequencies), r.ravel()])
    model = BeamModel(parameters, n_modes + 12)
    squared, V = linalg.eigh(model.matrices.K, model.matrices.M)
    omega, V = np.sqrt(squared[1 : n_modes + 1]), V[:, 1 : n_modes + 1]
    parts = [np.log(omega)]
    if heights.size:
        # u/f = 1/(M s^2) + sum u_r(z) alpha_r/(s^2 + omega_r^2): newtons make these absolute.
        # For a rig of about a kilogram they are of order 1, like the residues of prescribed motion.
        u = V[0] + model.shape(heights) @ V[1:]
        parts += [(u * V[0]).ravel(), np.array([-np.log(parameters.total_mass)])]
    return np.concatenate(parts)


def _perturbed(parameters: BeamParameters, name: str, step: float) -> BeamParameters:
    """Return the beam with one parameter changed by ``step`` of itself, or of the strip for what may be zero."""
    if name == "tip_mass":
        return replace(
            parameters,
            tip_mass=parameters.tip_mass
            + (1.0 + step) * 1e-2 * parameters.mass_per_length * parameters.length,
        )
    if name == "clamp_compliance":
        compliance = parameters.clamp_compliance + (1.0 + step) * 1e-2
        stiffness = parameters.flexural_rigidity / (compliance * parameters.length)
        return replace(parameters, clamp_stiffness=stiffness)
    if name == "length":
        # Markers and the like keep their heights.
        return replace(parameters, length=parameters.length * (1.0 + step))
    return replace(parameters, **{name: getattr(parameters, name) * (1.0 + step)})


_LOWER = {
    "stiffness": 1e-6,
    "viscous": -np.inf,
    "internal": -np.inf,
    "tip_mass": 0.0,
    "clamp_compliance": 0.0,
}


def _scales(nominal: BeamParameters, measurement: ModalMeasurement, names: tuple[str, ...]) -> FloatArray:
    """Return the parameters' typical sizes, so that the search sees numbers of order 1."""
    first = float(measurement.natural_frequencies[0])
    sizes = {
        "stiffness": nominal.time_scale**-2,
        "viscous": 0.02 * nominal.mass_per_length * first,
        "internal": 0.02 / first,
        "tip_mass": nominal.mass_per_length * nominal.length,
        "clamp_compliance": nominal.length / nominal.flexural_rigidity,
    }
    return np.array([sizes[name] for name in names])


def _start(nominal: BeamParameters, names: tuple[str, ...]) -> FloatArray:
    start = {
        "stiffness": nominal.time_scale**-2,
        "viscous": nominal.damping.viscous,
        "internal": nominal.damping.internal,
        "tip_mass": nominal.tip_mass,
        "clamp_compliance": 1.0 / nominal.clamp_stiffness,
    }
    return np.array([start[name] for name in names])


def _beam(nominal: BeamParameters, names: tuple[str, ...], values: FloatArray) -> BeamParameters:
    given = dict(zip(names, (float(value) for value in values), strict=True))
    EI = nominal.flexural_rigidity
    if "stiffness" in given:
        EI = given["stiffness"] * nominal.mass_per_length * nominal.length**4
    k = nominal.clamp_stiffness
    if "clamp_compliance" in given:
        k = 1.0 / given["clamp_compliance"] if given["clamp_compliance"] > 0.0 else np.inf
    damping = Damping(
        viscous=max(0.0, given.get("viscous", nominal.damping.viscous)),
        air=nominal.damping.air,
        internal=max(0.0, given.get("internal", nominal.damping.internal)),
    )
    return replace(
        nominal,
        flexural_rigidity=EI,
        tip_mass=given.get("tip_mass", nominal.tip_mass),
        clamp_stiffness=k,
        damping=damping,
    )


def _damping_ratios(
    beam: BeamParameters, basis: ModalBasis, names: tuple[str, ...], values: FloatArray
) -> FloatArray:
    """Return zeta of every mode; a damping may pass below zero here, so that zero is no wall to the fit."""
    given = dict(zip(names, values, strict=True))
    viscous = given.get("viscous", beam.damping.viscous) + beam.damping.air
    internal = given.get("internal", beam.damping.internal)
    C = (viscous + basis.air_damping) * np.diag(basis.strip_overlap) + internal * np.diag(
        basis.bending_stiffness
    )
    return np.asarray(C / (2.0 * basis.modal_mass * basis.natural_frequencies))


def _check_question(
    measurement: ModalMeasurement,
    names: tuple[str, ...],
    priors: Mapping[str, ParameterPrior],
    height_uncertainty: float | None,
) -> None:
    if not names:
        raise BeamParameterError("free", names, "", f"at least one of {', '.join(FREE)}")
    for name in (*names, *priors):
        if name not in FREE:
            raise BeamParameterError("free", name, "", f"among {', '.join(FREE)}")
    for name in ("tip_mass", "clamp_compliance"):
        if name not in names:
            continue
        if measurement.heights.size == 0:
            raise PhysicalFitError(
                f"frequencies cannot separate {name} from the stiffness: give residues of at least one marker"
            )
        if name not in priors:
            raise PhysicalFitError(f"{name} needs a stated prior: what is known of it without the experiment")
    if measurement.heights.size:
        if height_uncertainty is None:
            raise PhysicalFitError(
                "residues need the markers' height_uncertainty: 225 mm is 10 mm from a node"
            )
        check_number("height_uncertainty", height_uncertainty, "m", above=0.0)


def _vector(name: str, values: ArrayLike) -> FloatArray:
    vector = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if vector.ndim != 1 or not np.all(np.isfinite(vector)):
        raise BeamParameterError(name, vector.tolist(), "", "a row of finite numbers")
    return vector


def _covariance(name: str, values: ArrayLike, size: int) -> FloatArray:
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.shape != (size, size):
        raise BeamParameterError(name, matrix.shape, "", f"the shape ({size}, {size})")
    is_valid = bool(np.all(np.isfinite(matrix))) and np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0)
    if is_valid:
        deviations = np.sqrt(np.maximum(np.diag(matrix), 0.0))
        is_valid = bool(np.all(deviations > 0.0))
        if is_valid:
            is_valid = bool(np.linalg.eigvalsh(matrix / np.outer(deviations, deviations))[0] > 0.0)
    if not is_valid:
        raise BeamParameterError(name, matrix.tolist(), "", "symmetric and positive definite")
    return matrix
