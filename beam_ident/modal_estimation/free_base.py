"""Whether a force moves a free base at all, and whether that rolls on as it should or as under friction.

What a force acts on is free, with the structure "force", or held, with "receptance"; the first holds the second.
The structure "force" has a rigid body, ``c / s^2``; viscous friction makes it ``c / (s (s + p))``.  For a small p
the difference is ``-p c / s^3``: the triple integral of the force, which nothing else in the model can
pass for over a whole record.  What the residuals hold of it is an estimate of p by one step from
none, with the standard deviation that the residuals' own colour gives it.  Parts of it have gone into
the other parameters, so that it is rather too small.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from beam_ident.errors import EstimationError
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.identification_result import FrequencyDomainResult, IdentificationResult
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal.structure import StructureKind
from beam_ident.noise.autoregression import autoregression, score_covariance
from beam_ident.numerics.linear_least_squares import LinearSolution

_VISIBLE = 5.0  # standard deviations
NO_BODY = 1e-6  # level at which the outputs must follow a rigid body, as that of a mode's residues

ResultT = TypeVar("ResultT", IdentificationResult, FrequencyDomainResult)


def with_kind_of(kinds: Sequence[StructureKind], estimate: Callable[[StructureKind], ResultT]) -> ResultT:
    """Return an estimate with the first of some structures, or with the next where nothing is seen of a rigid body.

    Parameters
    ----------
    kinds : sequence of str -- by the units of the signals; the first holds the others
    estimate : callable -- returns the estimate with one of them

    Raises
    ------
    EstimationError
        Nothing can be estimated with the first, which is then refused by the others as well.
    """
    found = estimate(kinds[0])
    if len(kinds) == 1 or found.model.no_body_p_value() < NO_BODY:
        return found
    try:
        return estimate(kinds[1])
    except EstimationError:
        return found


@dataclass(frozen=True)
class FrictionEstimate:
    """The rate at which a free base loses its speed, to first order.

    Attributes
    ----------
    rate, rate_sd : float -- viscous friction over mass [rad/s]
    """

    rate: float
    rate_sd: float

    @property
    def is_visible(self) -> bool:
        """Whether there is friction beyond doubt."""
        return self.rate > _VISIBLE * self.rate_sd

    @staticmethod
    def of(fit: ModalFit, regression: ModalRegression) -> FrictionEstimate:
        """Look for friction in what a fit with a frictionless rigid body leaves.

        Parameters
        ----------
        fit : ModalFit
        regression : ModalRegression -- of the structure "force"
        """
        blocks = regression.blocks(fit.omegas, fit.zetas, fit.clock, gradients=True)
        triples = regression.position_integrals(fit.clock)
        along, power, variance = 0.0, 0.0, 0.0
        for j, (found, left, triple) in enumerate(zip(fit.coefficients, fit.residuals, triples, strict=True)):
            block = blocks[regression.block_of[j]]
            assert block.by_time is not None
            speed = block.by_time @ found
            clock = np.stack([speed * block.latency_factor, speed * block.rate_factor], axis=1)
            known = LinearSolution.of(np.concatenate([block.matrix, clock], axis=1))
            gains = found[: regression.n_shared_fixed : regression.n_fixed_of_input]
            column = known.left_of(-(triple @ gains) / fit.sigmas[j])
            noise = left / fit.sigmas[j]
            along += float(column @ noise)
            power += float(column @ column)
            variance += float(score_covariance(column[:, None], autoregression(noise))[0, 0])
        if not power > 0.0:
            return FrictionEstimate(0.0, math.inf)
        return FrictionEstimate(along / power, math.sqrt(max(variance, 0.0)) / power)

    def warning(self) -> str:
        """Return what a reader of the fit must know."""
        return (
            f"The base does not roll on as a free one: it loses its speed at {self.rate:.2g} rad/s or more "
            f"({self.rate / self.rate_sd:.0f} standard deviations), as under friction. Frequencies, damping ratios "
            "and gains are biased. Take the measured position of the base as the input ('base_motion'), or "
            "estimate_common_poles with one integrator and one more pole; identify_axis gives mass and friction."
        )
