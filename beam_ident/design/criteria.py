"""What "smallest uncertainty" means: D-, A- and c-optimality, as numbers and as slopes.

All are stated as one relative standard deviation, so that two designs can be compared and their ratio read: of D the
geometric mean over the principal axes of all natural frequencies and damping ratios, of A the root mean square over
these, of c the standard deviation of one named parameter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.errors import ExcitationError
from beam_ident.modal.model import ModalModel

_ROUNDING = 1e-12


@dataclass(frozen=True)
class Criterion:
    """Which uncertainty a design makes small.

    Parameters
    ----------
    kind : {"D", "A", "c"}
    parameter : str -- of c: one of the model's ``parameter_names``

    Raises
    ------
    ExcitationError
        Another kind.
    """

    kind: str
    parameter: str = ""

    def __post_init__(self) -> None:
        if self.kind not in ("D", "A", "c") or (self.kind == "c") != bool(self.parameter):
            raise ExcitationError(f"criterion is {str(self)!r}; expected D, A or c:NAME, as c:zeta_1")

    @classmethod
    def of(cls, text: str) -> Criterion:
        """Return the criterion that ``D``, ``A`` or ``c:NAME`` names."""
        kind, colon, parameter = text.partition(":")
        return cls(kind if kind != "c" or colon else text, parameter)

    def __str__(self) -> str:
        """Return it as it is written."""
        return f"c:{self.parameter}" if self.parameter else self.kind

    def place(self, model: ModalModel) -> int:
        """Return the place of c's parameter among the model's.

        Raises
        ------
        ExcitationError
            No parameter of the model, or the clock's rate, which no spectrum but only the length tells.
        """
        known = [name for name in model.parameter_names if name != "clock_rate"]
        if self.parameter not in known:
            raise ExcitationError(
                f"criterion c:{self.parameter}: no such parameter; expected one of {', '.join(known)}"
            )
        return model.parameter_names.index(self.parameter)

    def value(self, predicted: ModalModel) -> float:
        """Return the relative standard deviation that the criterion makes small, of a predicted model."""
        if self.kind == "c":
            place = self.place(predicted)
            sd = float(predicted.standard_deviations[place])
            return sd / (abs(float(predicted.parameters[place])) or 1.0)
        n = predicted.n_modes
        scale = 1.0 / predicted.parameters[: 2 * n]
        covariance = predicted.covariance[: 2 * n, : 2 * n] * np.outer(scale, scale)
        if self.kind == "A":
            return float(np.sqrt(np.trace(covariance) / (2 * n)))
        own = np.sqrt(np.diag(covariance))
        _, log_det = np.linalg.slogdet(covariance / np.outer(own, own))
        return float(np.exp((log_det + 2.0 * np.sum(np.log(own))) / (4 * n)))

    def log_variance(self, information: FloatArray, interest: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the logarithm of the variance that the criterion makes small, and by how much information lowers it.

        Parameters
        ----------
        information : ndarray, shape (n_draws, n, n)
        interest : ndarray, shape (n, n_interest)
            Columns of the combinations of parameters that count.

        Returns
        -------
        value : ndarray, shape (n_draws,)
        weight : ndarray, shape (n_draws, n, n) -- ``-d value / d information``

        Notes
        -----
        Of D, with C the covariance of what counts, ``-d log det C = tr(W dI)`` with ``W = I^-1 E C^-1 E' I^-1``; of
        A and c, ``W = I^-1 E E' I^-1 / tr C`` (Fedorov, Theory of Optimal Experiments, 1972).
        """
        scale = np.sqrt(np.maximum(np.einsum("dii->di", information), 1e-300))
        scaled = information / (scale[:, :, None] * scale[:, None, :]) + _ROUNDING * np.eye(len(interest))
        spread = np.linalg.solve(scaled, interest / scale[:, :, None]) / scale[:, :, None]
        covariance = interest.T @ spread
        if self.kind == "D":
            n = interest.shape[1]
            weight = spread @ np.linalg.solve(covariance, spread.transpose(0, 2, 1)) / n
            value = np.linalg.slogdet(covariance)[1] / n
        else:
            total = np.einsum("dii->d", covariance)
            weight = spread @ spread.transpose(0, 2, 1) / total[:, None, None]
            value = np.log(total)
        return np.asarray(value), np.asarray(weight)

    def slopes(self, information: FloatArray, lines: FloatArray, interest: FloatArray) -> FloatArray:
        """Return by how much the logarithm of 1 / variance grows with every line's power, on the mean of all draws.

        Parameters
        ----------
        information : ndarray, shape (n_draws, n, n) -- of all lines together
        lines : ndarray, shape (n_draws, n_lines, n, n) -- of every line at power 1
        interest : ndarray, shape (n, n_interest) -- as in ``log_variance``

        Returns
        -------
        ndarray, shape (n_lines,) -- their sum over the lines, times the powers, is 1
        """
        _, weight = self.log_variance(information, interest)
        n_draws, n_lines = lines.shape[:2]
        flat = lines.reshape(n_draws, n_lines, -1) @ weight.reshape(n_draws, -1, 1)
        return np.asarray(np.mean(flat[:, :, 0], axis=0))
