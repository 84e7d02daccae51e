"""Two modes beside a random walk that is louder than the second one: found without a hint, or not."""

from __future__ import annotations

import time

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.signal import cont2discrete, lfilter

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord, identify
from benchmarks.ident.study import AgainstBound, Outcome, Study

PERIOD_S, _N = 0.004, 2500
_POLES = np.array([2.0 * np.pi * 3.1, 2.0 * np.pi * 19.4, 0.012, 0.006])  # omega [rad/s], then zeta
_GAINS = np.array([[1.0, 0.6], [0.5, -0.8]])  # of every mode at each output
_WHITE = 0.003  # of an output's standard deviation
_STEP = 1e-5  # of a parameter, for central differences


class DriftingModes(AgainstBound):
    """A held force of random sign, and two outputs that drift.

    Parameters
    ----------
    share : float -- step of the walk from sample to sample, of an output's standard deviation
    """

    def __init__(self, share: float) -> None:
        self.share, self.truth = share, _POLES
        self.force = np.sign(np.random.default_rng(3).standard_normal(_N // 5)).repeat(5)
        self.clean = self._modes(_POLES) @ _GAINS
        self.sizes = np.std(self.clean, axis=0)
        count = np.arange(1.0, _N + 1.0)
        covariance = share**2 * np.minimum.outer(count, count) + _WHITE**2 * np.eye(_N)
        root = cholesky(covariance, lower=True)
        information = np.zeros((4, 4))
        for gains, size in zip(_GAINS.T, self.sizes, strict=True):
            columns = np.column_stack([*(self._slope(k) @ gains for k in range(4)), self._modes(_POLES)])
            white = solve_triangular(root, columns / size, lower=True)
            known = np.linalg.qr(white[:, 4:])[0]  # its own gains have to be estimated, too
            left = white[:, :4] - known @ (known.T @ white[:, :4])
            information += left.T @ left
        scale = np.sqrt(np.diag(information))
        self.bound = np.sqrt(np.diag(np.linalg.inv(information / np.outer(scale, scale)))) / scale

    def _modes(self, poles: np.ndarray) -> np.ndarray:
        """Return what every mode does under the held force, by exact steps, shape (n, 2)."""
        columns = []
        for omega, zeta in zip(poles[:2], poles[2:], strict=True):
            system = cont2discrete(([1.0], [1.0, 2.0 * zeta * omega, omega**2]), PERIOD_S)
            columns.append(lfilter(system[0][0], system[1], self.force))
        return np.stack(columns, axis=1)

    def _slope(self, k: int) -> np.ndarray:
        step = _STEP * _POLES[k] * (np.arange(4) == k)
        return (self._modes(_POLES + step) - self._modes(_POLES - step)) / (2.0 * step[k])

    def run(self, seed: int) -> Outcome:
        """Identify the record of one seed; another number of modes is no estimate."""
        rng = np.random.default_rng(seed)
        walk = np.cumsum(rng.standard_normal(self.clean.shape), axis=0)
        noise = self.share * walk + _WHITE * rng.standard_normal(self.clean.shape)
        seen = self.clean + self.sizes * noise
        outputs = tuple(OutputSignal(f"y{j}", "m", (0.0, PERIOD_S), seen[:, j]) for j in range(2))
        record = TimeRecord((InputSignal("force", "N", (0.0, PERIOD_S), self.force, "zoh"),), outputs)
        start = time.perf_counter()
        try:
            model = identify(record, "receptance").model
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        seconds = time.perf_counter() - start
        return Outcome.of_modes(seconds, model, len(_GAINS))


STUDIES = {
    f"drift-{name}": Study(
        f"two modes beside a random walk of {share:.0%} a sample",
        200,
        lambda share=share: DriftingModes(share),
    )
    for name, share in (("loud", 0.02), ("louder", 0.05))
}
