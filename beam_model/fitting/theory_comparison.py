"""Identified natural frequencies against theory, through an uncertainty budget of type B.

An identified frequency carries a statistical standard deviation of millihertz; a predicted one inherits what is known
of thickness, length, material, clamp and air. z-scores are taken with both together, and the statistical part is
shown apart: alone it would condemn every theory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from beam_model.arrays import FloatArray
from beam_model.errors import BeamParameterError
from beam_model.galerkin.model import BeamModel
from beam_model.parameters import BeamParameters, check_number


@dataclass(frozen=True)
class UncertaintyBudget:
    """Standard uncertainties of what the prediction rests on, relative unless a unit is named.

    Attributes
    ----------
    thickness : float
        Of a rolled strip; frequencies are proportional to it.
    youngs_modulus, density : float
    length : float
        [m].
    tip_mass : float
        Relative to the tip mass.
    marker_masses : float
        Relative to the point masses.
    clamp_shift, clamp : float
        How far a real clamp lowers the frequencies, and how well that is known.
    air_shift, air : float
        The same for the air that moves along; the shift is left out for a beam with ``air``.
    temperature : float
        Of the beam against that of its data [K]; steel's frequencies fall by 0.0125 % per kelvin.
    camera_clock : float
        Of the time base in which frequencies were measured.
    """

    thickness: float = 0.02
    youngs_modulus: float = 0.02
    density: float = 0.005
    length: float = 0.0005
    tip_mass: float = 0.01
    marker_masses: float = 0.1
    clamp_shift: float = -0.0045
    clamp: float = 0.0015
    air_shift: float = -0.0035
    air: float = 0.001
    temperature: float = 3.0
    camera_clock: float = 50e-6

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if name.endswith("_shift"):
                check_number(f"budget.{name}", value, "", at_least=-0.5, at_most=0.5)
            else:
                check_number(f"budget.{name}", value, "", at_least=0.0)


_TEMPERATURE_COEFFICIENT = 1.25e-4


@dataclass(frozen=True)
class TheoryComparison:
    """Measured natural frequencies against predicted ones.

    Attributes
    ----------
    measured, predicted : ndarray, shape (n_modes,)
        omega [rad/s]; predicted with the budget's shifts for clamp and air.
    deviations : ndarray, shape (n_modes,)
        measured / predicted - 1.
    contributions : dict of str to ndarray, shape (n_modes,)
        Signed relative standard uncertainty of the prediction from each source; one source moves all modes together.
    statistical : ndarray, shape (n_modes,)
        Relative standard deviation of the measurement.
    combined : ndarray, shape (n_modes,)
        Relative, of the deviation.
    z_scores : ndarray, shape (n_modes,)
        deviations / combined.
    chi_squared : float
        Of all modes together, with the correlations between them.
    """

    measured: FloatArray
    predicted: FloatArray
    deviations: FloatArray
    contributions: dict[str, FloatArray]
    statistical: FloatArray
    combined: FloatArray
    z_scores: FloatArray
    chi_squared: float


def compare_with_theory(
    parameters: BeamParameters,
    natural_frequencies: ArrayLike,
    standard_deviations: ArrayLike,
    budget: UncertaintyBudget | None = None,
) -> TheoryComparison:
    """Compare identified clamped frequencies, from mode 1 up, with those of the beam.

    Parameters
    ----------
    parameters : BeamParameters
        The beam as it is known without the experiment.
    natural_frequencies, standard_deviations : array_like, shape (n_modes,)
        Identified omega and its statistical standard deviation [rad/s].
    budget : UncertaintyBudget, optional
    """
    budget = UncertaintyBudget() if budget is None else budget
    measured = np.atleast_1d(np.asarray(natural_frequencies, dtype=np.float64))
    sigma = np.atleast_1d(np.asarray(standard_deviations, dtype=np.float64))
    if not np.all(np.isfinite(measured)) or not np.all(measured > 0.0):
        raise BeamParameterError("natural_frequencies", measured.tolist(), "rad/s", "finite and above 0")
    if sigma.shape != measured.shape or not np.all(sigma >= 0.0):
        raise BeamParameterError(
            "standard_deviations", sigma.tolist(), "rad/s", f"{measured.size} values of at least 0"
        )
    n = measured.size
    base = BeamModel(parameters, n).natural_frequencies

    def effect(changed: BeamParameters) -> FloatArray:
        return np.asarray(BeamModel(changed, n).natural_frequencies / base - 1.0)

    EI, rho, L = parameters.flexural_rigidity, parameters.mass_per_length, parameters.length
    t = budget.thickness
    contributions = {
        "thickness": effect(
            replace(parameters, flexural_rigidity=EI * (1 + t) ** 3, mass_per_length=rho * (1 + t))
        ),
        "Young's modulus": effect(replace(parameters, flexural_rigidity=EI * (1 + budget.youngs_modulus))),
        "density": effect(replace(parameters, mass_per_length=rho * (1 + budget.density))),
        "length": effect(replace(parameters, length=L + budget.length)),
        "tip mass": effect(replace(parameters, tip_mass=parameters.tip_mass * (1 + budget.tip_mass))),
        "marker masses": effect(
            replace(
                parameters,
                point_masses=tuple(
                    replace(mass, mass=mass.mass * (1 + budget.marker_masses))
                    for mass in parameters.point_masses
                ),
            )
        ),
        "clamp": np.full(n, budget.clamp),
        "air": np.full(n, budget.air),
        "temperature": np.full(n, -_TEMPERATURE_COEFFICIENT * budget.temperature),
        "camera clock": np.full(n, budget.camera_clock),
    }
    # A beam in still air has its shift already.
    air_shift = budget.air_shift if parameters.air is None else 0.0
    predicted = base * (1.0 + budget.clamp_shift + air_shift)
    deviations = measured / predicted - 1.0
    statistical = sigma / measured
    covariance = np.diag(statistical**2) + sum(np.outer(c, c) for c in contributions.values())
    combined = np.sqrt(np.diag(covariance))
    # Modes beyond what the budget lets vary apart: a floor at rounding keeps the matrix invertible.
    covariance = covariance + 1e-12 * np.diag(np.diag(covariance))
    return TheoryComparison(
        measured=measured,
        predicted=predicted,
        deviations=deviations,
        contributions=contributions,
        statistical=statistical,
        combined=combined,
        z_scores=deviations / combined,
        chi_squared=float(deviations @ np.linalg.solve(covariance, deviations)),
    )
