"""A beam of two modes on a led axis, and an oscillator that knows nothing of phasors."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from beam_ident import ExcitationLimits, ModalModel
from beam_ident.excitation import AxisLimits
from beam_ident.shaping.command import Move

LIMITS = ExcitationLimits(AxisLimits(travel=0.05, speed=0.5, acceleration=8.0, jerk=600.0))
OMEGAS, ZETAS = 2 * np.pi * np.array([4.4, 28.0]), np.array([0.005, 0.008])


def beam_model(frequency_sd: float = 1e-4, damping_sd: float = 0.01) -> ModalModel:
    """Return a model whose poles are known this well, relative; its shares to 0.1 %."""
    residues = np.array([[1.45, -0.66], [1.03, 0.12]])
    variances = np.concatenate(
        [
            (frequency_sd * OMEGAS) ** 2,
            (damping_sd * ZETAS) ** 2,
            np.zeros(2),
            *(np.array([0.0, 0.0, *(1e-3 * row) ** 2]) for row in residues),
        ]
    )
    return ModalModel(
        "base_motion",
        "hub",
        ("tip", "middle"),
        OMEGAS,
        ZETAS,
        residues,
        np.zeros(2),
        np.ones(2),
        0.0,
        0.0,
        np.diag(variances),
        np.full(2, 5e-6),
    )


def amplitude_after(move: Move, omega: float, zeta: float, hold: str = "acceleration") -> float:
    """Return the amplitude that an oscillator keeps, from its equation of motion integrated numerically."""
    period = move.period_s
    state = np.zeros(2)
    positions = move.positions
    if hold == "position":
        slopes = np.diff(positions) / period
        jumps, held = np.diff(slopes, prepend=0.0, append=0.0), np.zeros(len(slopes))
    else:
        jumps, held = np.zeros(len(move.accelerations) + 1), move.accelerations
    for jump, a in zip(jumps, [*held, None], strict=True):
        state = state - np.array([0.0, jump])
        if a is not None:
            state = solve_ivp(
                lambda _, s, a=a: [s[1], -2 * zeta * omega * s[1] - omega**2 * s[0] - a],
                (0.0, period),
                state,
                rtol=1e-10,
                atol=1e-14,
            ).y[:, -1]
    root = omega * np.sqrt(1.0 - zeta**2)
    return float(np.hypot(state[0], (state[1] + zeta * omega * state[0]) / root))
