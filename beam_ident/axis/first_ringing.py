"""What a spring rings with when a piece begins: integrated out of the likelihood, not only fitted.

A servo turns the noise of its encoder into a force, and that makes a spring ring. The ringing at the beginning of a
piece is not known. If it is only fitted, it fits the noise of the first positions; the servo has answered that noise,
so that what is left of it goes with the ringing that follows. Slowly fading springs gain by this: in closed loop the
damping came out too small, now and then as zero.

A ringing c with c ~ N(0, 1 / W), beside the information S of the positions on it, is integrated out in closed form:

    -log p(y) = -log p(y | c) + c^T W c / 2 + log det(W + S) / 2 - log det(W) / 2

at the most likely c, apart from a constant. W is kept while an optimum is approached; it counts where two of them are
compared, a spring that rings and one that creeps. Among what S depends on, only how fast the ringing fades counts:

    S ~ integral_0^T exp(-2 zeta omega t) dt = (1 - exp(-2 zeta omega T)) / (2 zeta omega)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray

_STEP = 1e-3  # of the rate of fading, for a derivative by differences


@dataclass(frozen=True, eq=False)
class FirstRinging:
    """What is known of the ringing at the beginning of every piece.

    Attributes
    ----------
    weights : ndarray, shape (2,) -- W: one over the variance of its deflection and of its rate
    shown : ndarray, shape (n_pieces, 2, 2) -- S at the fading ``fading``
    durations_s : ndarray, shape (n_pieces,)
    fading : float -- zeta omega [1/s]
    """

    weights: FloatArray
    shown: FloatArray
    durations_s: FloatArray
    fading: float

    @staticmethod
    def of(
        weights: FloatArray, informations: Sequence[FloatArray], durations_s: Sequence[float], fading: float
    ) -> FirstRinging:
        """Return it from the information on each piece's own velocity, deflection and rate, (3, 3), without W."""
        # The velocity is not known either: what only it explains says nothing of the ringing.
        shown = [own[1:, 1:] - np.outer(own[1:, 0], own[0, 1:]) / own[0, 0] for own in informations]
        return FirstRinging(weights, np.array(shown), np.array(durations_s), fading)

    def cost(self, fading: float) -> float:
        """Return half of the sum of log det(W + S) - log det(W) at another fading [1/s]."""
        share = _heard(fading, self.durations_s) / _heard(self.fading, self.durations_s)
        whole = np.diag(self.weights) + self.shown * share[:, None, None]
        expected = float(np.sum(np.log(self.weights)))
        return 0.5 * float(np.sum(np.linalg.slogdet(whole)[1] - expected))

    def slope(self, fading: float) -> float:
        """Return the derivative of the cost by the fading [s]."""
        step = _STEP * fading
        return (self.cost(fading + step) - self.cost(fading - step)) / (2.0 * step)


def _heard(fading: float, durations_s: FloatArray) -> FloatArray:
    """Return for how long a ringing of that fading could be heard at full strength [s]."""
    if fading <= math.ulp(1.0) / float(np.max(durations_s)):
        return durations_s
    return np.asarray(-np.expm1(-2.0 * fading * durations_s) / (2.0 * fading))
