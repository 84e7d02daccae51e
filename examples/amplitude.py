"""Frequency and damping over amplitude: a swing that dry friction and air slow down, and one that nothing bends."""

import numpy as np
from scipy.integrate import solve_ivp

from beam_ident import EstimationError, OutputSignal, amplitude_curves

FREQUENCY = 2.0 * np.pi * 4.4
T = np.arange(0.0, 20.0, 0.01)


def decay(drag: float, friction: float, stiffening: float, seed: int) -> OutputSignal:
    """Return the swings of x'' + 2 zeta w x' + w^2 x + stiffening x^3 + drag |x'| x' + friction sign(x') = 0."""

    def motion(_: float, state: np.ndarray) -> tuple[float, float]:
        x, v = state
        resistance = 0.006 * FREQUENCY * v + drag * abs(v) * v + friction * np.tanh(v / 1e-5)
        return v, -(FREQUENCY**2) * x - stiffening * x**3 - resistance

    found = solve_ivp(motion, (0.0, T[-1]), (0.015, 0.0), t_eval=T, rtol=1e-8, atol=1e-11)
    return OutputSignal(
        "tip", "m", T, found.y[0] + 1e-5 * np.random.default_rng(seed).standard_normal(len(T))
    )


curves = amplitude_curves(decay(drag=0.5, friction=2e-3, stiffening=3e4, seed=1))
print(curves.verdict)
for k in range(0, len(curves.amplitudes), len(curves.amplitudes) // 4):
    low, high = curves.damping_band[:, k]
    print(f"{1e3 * curves.amplitudes[k]:6.2f} mm  {curves.frequencies_hz[k]:.4f} Hz  {low:.4%} to {high:.4%}")

# Without air, friction and a curved spring one pole is enough, and it is said.
print(amplitude_curves(decay(drag=0.0, friction=0.0, stiffening=0.0, seed=2)).verdict)

# A decay that ends after a few swings has no curve to show.
whole = decay(drag=0.5, friction=2e-3, stiffening=3e4, seed=3)
try:
    amplitude_curves(OutputSignal("tip", "m", T[:40], whole.values[:40]))
except EstimationError as err:
    print(f"refused: {err}")
