"""Whether estimates from several records scatter as much as they say they do.

A standard deviation is a promise about repetition.  Records of the same system under the same
conditions keep it: the scatter of the estimates over them is compared with the stated deviations by
a chi-squared test, parameter by parameter and jointly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import FloatArray
from beam_ident.errors import EstimationError
from beam_ident.evaluation.model_comparison import compare_models
from beam_ident.modal.model import ModalModel
from beam_ident.transfer_function.model import TransferFunctionModel

_TAIL = 0.005  # of either side: one correct set of records in a hundred is doubted


@dataclass(frozen=True, eq=False)
class ParameterScatter:
    """One parameter over several records.

    Attributes
    ----------
    name : str
    values, stated_sd : ndarray, shape (n_records,)
    mean : float -- weighted by the stated variances
    mean_sd : float -- stated standard deviation of that mean
    scatter : float -- standard deviation of the values about their mean
    ratio : float -- square root of chi-squared over its degrees of freedom: 1 where the promise is kept
    p_value : float -- probability of a larger scatter where the promise is kept
    """

    name: str
    values: FloatArray
    stated_sd: FloatArray
    mean: float
    mean_sd: float
    scatter: float
    ratio: float
    p_value: float

    @staticmethod
    def of(name: str, values: FloatArray, stated_sd: FloatArray) -> ParameterScatter:
        """Weigh the scatter of a parameter with its stated standard deviations."""
        weights = 1.0 / stated_sd**2
        mean = float(np.sum(weights * values) / np.sum(weights))
        statistic = float(np.sum(weights * (values - mean) ** 2))
        degrees = len(values) - 1
        return ParameterScatter(
            name=name,
            values=values,
            stated_sd=stated_sd,
            mean=mean,
            mean_sd=float(1.0 / np.sqrt(np.sum(weights))),
            scatter=float(np.std(values, ddof=1)),
            ratio=float(np.sqrt(statistic / degrees)),
            p_value=float(chi_squared_sf(degrees, statistic)),
        )


@dataclass(frozen=True, eq=False)
class Repeatability:
    """Scatter of the estimates over records against their stated standard deviations.

    Attributes
    ----------
    n_records : int
    parameters : tuple of ParameterScatter
        Natural frequencies [rad/s] and damping ratios of the modes that every model has, or the coefficients
        of a transfer function.
    chi_squared : float -- of all parameters jointly, with their covariances
    degrees_of_freedom : int
    p_value : float -- probability of a larger value where the promise is kept
    n_unmatched : int -- modes that some model lacks
    """

    n_records: int
    parameters: tuple[ParameterScatter, ...]
    chi_squared: float
    degrees_of_freedom: int
    p_value: float
    n_unmatched: int

    @property
    def ratio(self) -> float:
        """Joint scatter over what the standard deviations say."""
        return float(np.sqrt(self.chi_squared / self.degrees_of_freedom))

    @property
    def is_as_stated(self) -> bool:
        """Whether scatter and stated deviations agree, in either direction."""
        return _TAIL <= self.p_value <= 1.0 - _TAIL

    @property
    def verdict(self) -> str:
        """What the comparison says, in words."""
        figures = f"{self.ratio:.2f} times what their standard deviations say (p = {self.p_value:.2g})"
        unmatched = f"; {self.n_unmatched} modes are not in every model" if self.n_unmatched else ""
        if self.is_as_stated:
            return f"as stated: the {self.n_records} records scatter {figures}{unmatched}"
        if self.p_value < _TAIL:
            worst = max(self.parameters, key=lambda parameter: parameter.ratio)
            where = (
                f"{worst.name} most with {worst.ratio:.1f}"
                if worst.p_value < _TAIL
                else "all together, none by itself"
            )
            return (
                f"more than stated: the {self.n_records} records scatter {figures}, {where}: the system or the "
                f"set-up changed from record to record, or the deviations leave something out{unmatched}"
            )
        return (
            f"less than stated: the {self.n_records} records scatter {figures}: they share noise or data, or "
            f"the deviations are too large{unmatched}"
        )


def assess_repeatability(models: Sequence[ModalModel] | Sequence[TransferFunctionModel]) -> Repeatability:
    """Compare models of the same system from independent records.

    Parameters
    ----------
    models : sequence of ModalModel or of TransferFunctionModel
        One from each record; transfer functions all of one structure.

    Raises
    ------
    EstimationError
        Fewer than two models, models of different kinds or structures, no mode in common, or no stated deviations.

    Notes
    -----
    With estimates ``x_i`` and covariances ``C_i`` the weighted mean is ``m = (sum C_i^-1)^-1 sum C_i^-1 x_i`` and
    ``sum (x_i - m)' C_i^-1 (x_i - m)`` is chi-squared with ``(n_records - 1) n_parameters`` degrees of freedom
    where the covariances are right.  Latency, clock rate and residues are left out: a camera that is moved
    between records changes them without changing the beam.
    """
    if not isinstance(models, Sequence):
        raise EstimationError(f"models is a {type(models).__name__}; expected a list of at least two")
    if len(models) < 2:
        raise EstimationError(f"models: {len(models)} given; expected at least two records to compare")
    modal = [model for model in models if isinstance(model, ModalModel)]
    rational = [model for model in models if isinstance(model, TransferFunctionModel)]
    if len(modal) == len(models):
        names, values, covariances, n_unmatched = _of_modes(modal)
    elif len(rational) == len(models):
        names, values, covariances = _of_coefficients(rational)
        n_unmatched = 0
    else:
        raise EstimationError("models: modal models and transfer functions together; expected one kind")
    deviations = np.sqrt(np.array([np.diag(covariance) for covariance in covariances]))
    if not np.all(deviations > 0.0):
        place = names[int(np.argmax(~np.all(deviations > 0.0, axis=0)))]
        raise EstimationError(f"{place} has no stated standard deviation; expected estimated parameters")
    # In units of the deviations, as frequencies and dampings differ by orders of magnitude.
    scale = np.median(deviations, axis=0)
    inverses = [np.linalg.pinv(covariance / np.outer(scale, scale)) for covariance in covariances]
    scaled = values / scale
    weighted = np.sum([inverse @ value for inverse, value in zip(inverses, scaled, strict=True)], axis=0)
    mean = np.linalg.pinv(np.sum(inverses, axis=0)) @ weighted
    statistic = float(
        np.sum([(v - mean) @ inverse @ (v - mean) for inverse, v in zip(inverses, scaled, strict=True)])
    )
    degrees = (len(models) - 1) * len(names)
    return Repeatability(
        n_records=len(models),
        parameters=tuple(
            ParameterScatter.of(name, values[:, k], deviations[:, k]) for k, name in enumerate(names)
        ),
        chi_squared=statistic,
        degrees_of_freedom=degrees,
        p_value=float(chi_squared_sf(degrees, statistic)),
        n_unmatched=n_unmatched,
    )


def _of_modes(models: list[ModalModel]) -> tuple[list[str], FloatArray, list[FloatArray], int]:
    """Collect frequencies and dampings of the modes that every model has, paired with the first one's."""
    first = models[0]
    partners = [dict(compare_models(first, model).pairs) for model in models]
    common = [k for k in range(first.n_modes) if all(k in pairs for pairs in partners)]
    if not common:
        raise EstimationError(
            "the models have no mode in common; expected models of the same system, with frequencies within 25 %"
        )
    values, covariances = [], []
    for model, pairs in zip(models, partners, strict=True):
        mine = [pairs[k] for k in common]
        places = mine + [model.n_modes + k for k in mine]
        values.append(model.parameters[places])
        covariances.append(model.covariance[np.ix_(places, places)])
    names = [f"omega_{k + 1}" for k in common] + [f"zeta_{k + 1}" for k in common]
    n_unmatched = sum(model.n_modes - len(common) for model in models)
    return names, np.array(values), covariances, n_unmatched


def _of_coefficients(models: list[TransferFunctionModel]) -> tuple[list[str], FloatArray, list[FloatArray]]:
    """Collect the coefficients that were estimated."""
    names = models[0].parameter_names
    if any(model.parameter_names != names for model in models):
        raise EstimationError(
            "models: transfer functions of different orders; expected the same numbers of poles and zeros"
        )
    free = [k for k in range(len(names)) if any(model.standard_deviations[k] > 0.0 for model in models)]
    if not free:
        raise EstimationError("models: no coefficient has a stated standard deviation")
    return (
        [names[k] for k in free],
        np.array([model.parameters[free] for model in models]),
        [model.covariance[np.ix_(free, free)] for model in models],
    )
