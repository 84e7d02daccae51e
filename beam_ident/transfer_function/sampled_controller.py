"""The controller of a loop, and the input that it gives a plant when there is no noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from beam_ident.arrays import FloatArray
from beam_ident.errors import EstimationError


@dataclass(frozen=True, eq=False)
class SampledController:
    """A linear controller that acts once in every period and holds its output.

    Parameters
    ----------
    numerator, denominator : ndarray -- coefficients of z^0, z^-1, z^-2 ..
    period_s : float -- [s]
    reference_enters : {"error", "input"}
        "error": ``u = C (r - y)``, the reference is compared with the output;
        "input": ``u = r - C y``, the reference is added to what the controller puts out.

    Raises
    ------
    EstimationError
        Empty or infinite coefficients, a denominator that begins with zero, no period.
    """

    numerator: FloatArray
    denominator: FloatArray
    period_s: float
    reference_enters: str = "error"

    def __post_init__(self) -> None:
        for name in ("numerator", "denominator"):
            values = np.array(getattr(self, name), dtype=np.float64, copy=True, ndmin=1)
            if values.ndim != 1 or not np.all(np.isfinite(values)) or not np.any(values):
                raise EstimationError(
                    f"controller: {name} is {getattr(self, name)!r}; expected finite coefficients of "
                    "z^0, z^-1, .. in a row, not all zero"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.denominator[0] == 0.0:
            raise EstimationError(
                "controller: the denominator begins with 0; expected the coefficient of the present output first"
            )
        if not (math.isfinite(self.period_s) and self.period_s > 0.0):
            raise EstimationError(f"controller: period_s is {self.period_s}; expected a time > 0 [s]")
        if self.reference_enters not in ("error", "input"):
            raise EstimationError(
                f"controller: reference_enters is {self.reference_enters!r}; expected 'error' or 'input'"
            )

    def plant_inputs(
        self, theta: FloatArray, n: int, scale: float, references: Sequence[FloatArray]
    ) -> list[FloatArray] | None:
        """Return the plant's input in a loop without noise, or None where that loop is unstable.

        Parameters
        ----------
        theta : ndarray -- of the plant: a_1 .. a_n, b_0 .. b_m of ascending powers, in units of ``scale``
        n : int -- degree of its denominator
        scale : float -- unit of frequency [rad/s]
        references : sequence of ndarray -- one for every record, sampled by the period; from rest
        """
        from scipy.signal import sosfilt, zpk2sos  # here: it takes longer to load than an estimator

        # Controller form of the plant in scaled time, and its exact sampling under the hold.
        system = np.zeros((n + 1, n + 1))
        system[0, :n] = -theta[:n]
        system[np.arange(1, n), np.arange(n - 1)] = 1.0
        system[0, n] = 1.0
        sampled = expm(system * scale * self.period_s)
        transition, entry = sampled[:n, :n], sampled[:n, n]
        readout = np.zeros(n)
        readout[n - 1 - np.arange(len(theta) - n)] = theta[n:]
        size = max(len(self.numerator), len(self.denominator))
        above = np.pad(self.numerator, (0, size - len(self.numerator))) / self.denominator[0]
        below = np.pad(self.denominator, (0, size - len(self.denominator))) / self.denominator[0]
        # Observer form of the controller: v = above[0] e + first state.
        order = size - 1
        inner = np.zeros((order, order))
        inner[:, :1] = -below[1:, None]
        inner[np.arange(order - 1), np.arange(1, order)] = 1.0
        gains = above[1:] - below[1:] * above[0]
        first = np.zeros(order)
        first[:1] = 1.0
        loop = np.block(
            [
                [transition - above[0] * np.outer(entry, readout), np.outer(entry, first)],
                [-np.outer(gains, readout), inner],
            ]
        )
        poles = np.linalg.eigvals(loop)
        if np.any(np.abs(poles) >= 1.0):
            return None
        if self.reference_enters == "error":
            late = int(np.flatnonzero(above)[0])  # periods: the sections know poles and zeros alone
            zeros, gain = np.roots(above), above[late]
        else:
            late, zeros, gain = 0, np.linalg.eigvals(inner), 1.0
        zeros = np.concatenate([zeros, np.linalg.eigvals(transition)])
        sections = zpk2sos(zeros, poles, gain)
        return [np.pad(sosfilt(sections, own), (late, 0))[: len(own)] for own in references]
