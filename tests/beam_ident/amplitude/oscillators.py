"""Nonlinear oscillators whose curves are read off their maxima and zero crossings, without any estimator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.signal import lsim

from beam_ident import InputSignal, OutputSignal, TimeRecord

OMEGA = 2.0 * np.pi * 4.4
UNIT = 0.02


@dataclass(frozen=True)
class Oscillator:
    """x'' + 2 zeta omega x' + mu sign(x') + beta |x'| x' + omega^2 x + kappa x^3 = 0, let go at ``UNIT``.

    Attributes
    ----------
    zeta : float -- linear damping
    dry, quadratic : float -- what dry and quadratic damping add to the damping ratio at ``UNIT``
    hardening : float -- what the cubic spring adds to the frequency at ``UNIT``, relative
    """

    zeta: float = 0.004
    dry: float = 0.0
    quadratic: float = 0.0
    hardening: float = 0.0

    def swing(self, duration_s: float, rate: float) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps and x, integrated from one reversal to the next, between which the friction is constant."""
        mu = self.dry * np.pi * OMEGA**2 * UNIT / 2.0
        beta = self.quadratic * 3.0 * np.pi / (4.0 * UNIT)
        kappa = self.hardening * 8.0 * OMEGA**2 / (3.0 * UNIT**2)
        times = np.arange(0.0, duration_s, 1.0 / rate)
        x = np.zeros(len(times))
        now, place, side = 0.0, UNIT, -1.0
        while now < times[-1] and OMEGA**2 * abs(place) > mu:

            def slope(_t: float, y: np.ndarray, side: float = side) -> list[float]:
                position, velocity = y
                force = 2.0 * self.zeta * OMEGA * velocity + mu * side + beta * side * velocity**2
                return [velocity, -force - OMEGA**2 * position - kappa * position**3]

            half = solve_ivp(
                slope,
                (now, now + 0.7 * 2.0 * np.pi / OMEGA),
                [place, 0.0],
                rtol=1e-10,
                atol=1e-14,
                method="DOP853",
                dense_output=True,
            )
            begin = now + 0.2 * 2.0 * np.pi / OMEGA
            end = brentq(lambda t, path=half.sol: path(t)[1], begin, half.t[-1], xtol=1e-12)
            inside = (times >= now) & (times < end)
            x[inside] = half.sol(times[inside])[0]
            now, place, side = end, float(half.sol(end)[0]), -side
        x[times >= now] = place if OMEGA**2 * abs(place) <= mu else x[times >= now]
        return times, x

    def curves(self, duration_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return amplitudes, frequencies [Hz] and damping ratios from the reversals of a long decay."""
        return read_off(*self.swing(duration_s, 4000.0))


def read_off(t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return maxima, frequencies [Hz] and damping ratios of the half cycles of a finely sampled decay."""
    at = np.flatnonzero(np.signbit(x[:-1]) != np.signbit(x[1:]))
    crossings = t[at] - x[at] * (t[at + 1] - t[at]) / (x[at + 1] - x[at])
    size = np.abs(x)
    tops = np.array([first + 1 + int(np.argmax(size[first + 1 : last + 1])) for first, last in pairwise(at)])
    before, top, after = size[tops - 1], size[tops], size[tops + 1]
    maxima = top + (before - after) ** 2 / (8.0 * (2.0 * top - before - after))
    logs = np.log(maxima)
    # Decrements over one cycle and over two: from both, that at the maximum itself.
    one, two = (logs[1:-3] - logs[3:-1]) / (2.0 * np.pi), (logs[:-4] - logs[4:]) / (4.0 * np.pi)
    return maxima[2:-2], 0.5 / np.diff(crossings)[2:-2], (4.0 * one - two) / 3.0


def released(force: Callable[[float, float], float], blow: tuple[float, float] = (15.0, 0.0)) -> np.ndarray:
    """Return x of x'' = -force(x, x') at 4000 samples a second for 15 s, let go at ``UNIT``; a blow adds speed."""
    t, y = np.arange(0.0, 15.0, 1.0 / 4000.0), [UNIT, 0.0]
    parts, begin = [], 0.0
    for end in sorted({blow[0], 15.0}):
        found = solve_ivp(
            lambda _t, y: [y[1], -force(y[0], y[1])],
            (begin, end),
            y,
            "DOP853",
            rtol=1e-11,
            atol=1e-15,
            max_step=0.01,
            dense_output=True,
        )
        parts.append(found.sol(t[(t >= begin) & (t < end)])[0])
        y, begin = [found.y[0, -1], found.y[1, -1] + blow[1]], end
    return np.concatenate(parts)


def noisy(
    oscillator: Oscillator, noise: float, seed: int, duration_s: float = 15.0, rate: float = 100.0
) -> OutputSignal:
    """Return a decay as a camera sees it."""
    t, x = oscillator.swing(duration_s, rate)
    return OutputSignal("z285", "m", t, x + noise * np.random.default_rng(seed).standard_normal(len(t)))


def driven_record(
    oscillator: Oscillator,
    seed: int,
    level: float = 1.0,
    noise: float = 1e-5,
    duration_s: float = 20.0,
    band_hz: tuple[float, float] = (3.0, 6.0),
) -> TimeRecord:
    """Return an oscillator on a moving base as a camera sees it: Runge and Kutta's steps of half a millisecond.

    The base swings by lines of random phase in a band; level 1 brings the oscillator to about ``UNIT``.
    """
    rng = np.random.default_rng(seed)
    lines = np.arange(round(band_hz[0] * duration_s), round(band_hz[1] * duration_s) + 1) / duration_s
    phases = rng.uniform(0.0, 2.0 * np.pi, lines.size)
    step, fine = 5e-4, np.arange(0.0, duration_s, 2.5e-4)
    waves = 2.0 * np.pi * lines[:, None] * fine + phases[:, None]
    size = level * 1.1e-3 / np.sqrt(lines.size)
    ramp = np.clip(fine / 1.0, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(fine / 1.0, 0.0, 1.0))
    position = size * ramp * np.cos(waves).sum(axis=0)
    acceleration = np.gradient(np.gradient(position, fine), fine)
    mu = oscillator.dry * np.pi * OMEGA**2 * UNIT / 2.0
    beta = oscillator.quadratic * 3.0 * np.pi / (4.0 * UNIT)
    kappa = oscillator.hardening * 8.0 * OMEGA**2 / (3.0 * UNIT**2)
    viscous, stiffness = 2.0 * oscillator.zeta * OMEGA, OMEGA**2

    def stepped(x: float, v: float, h: float, side: float, drive: tuple[float, ...]) -> tuple[float, float]:
        """Return where a step of ``h`` leads under a friction that keeps its side."""

        def slope(x: float, v: float, a: float) -> float:
            return -viscous * v - mu * side - beta * abs(v) * v - stiffness * x - kappa * x**3 - a

        a0, a1, a2 = drive
        k1, l1 = v, slope(x, v, a0)
        k2, l2 = v + 0.5 * h * l1, slope(x + 0.5 * h * k1, v + 0.5 * h * l1, a1)
        k3, l3 = v + 0.5 * h * l2, slope(x + 0.5 * h * k2, v + 0.5 * h * l2, a1)
        k4, l4 = v + h * l3, slope(x + h * k3, v + h * l3, a2)
        return x + h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0, v + h * (l1 + 2.0 * l2 + 2.0 * l3 + l4) / 6.0

    x, v, path = 0.0, 0.0, [0.0]
    for drive in zip(acceleration[:-2:2], acceleration[1:-1:2], acceleration[2::2], strict=False):
        side = float(np.sign(v))
        ahead = stepped(x, v, step, side, drive)
        if mu > 0.0 and v * ahead[1] < 0.0:
            # Friction turns over where the velocity is zero: the step is taken in two.
            share = v / (v - ahead[1])
            x, v = stepped(x, v, share * step, side, drive)
            ahead = stepped(x, 0.0, (1.0 - share) * step, -side, drive)
        x, v = ahead
        path.append(x)
    seen = np.arange(0, len(path) - 20, 20)
    y = position[::2][seen] + np.array(path)[seen] + noise * rng.standard_normal(seen.size)
    base = InputSignal("hub", "m", (0.0, 1e-3), position[::4], "cubic")
    return TimeRecord(
        (base,), (OutputSignal("z285", "m", 0.01 * np.arange(seen.size), y),), name=f"level {level:g}"
    )


def moved_hub(seed: int, encoder: float, hardening: float = 0.0) -> TimeRecord:
    """Return two points of a mode of 4.4 Hz on a hub that moves five times, seen by an encoder with noise."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 1e-3)
    hub, omega = np.zeros(len(t)), 2.0 * np.pi * 4.4
    for begin, distance in ((1.0, 0.02), (3.5, -0.04), (6.0, 0.035), (8.5, -0.025), (11.0, 0.01)):
        share = np.clip((t - begin) / 0.35, 0.0, 1.0)
        hub += distance * (10.0 * share**3 - 15.0 * share**4 + 6.0 * share**5)
    push = -1.5 * np.gradient(np.gradient(hub, t), t)
    system = ([[0.0, 1.0], [-(omega**2), -0.01 * omega]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    _, swing, _ = lsim(system, push, t)
    for _ in range(4 if hardening else 0):  # to first order and on: the spring's force as one more push
        _, swing, _ = lsim(system, push - hardening * omega**2 * swing**3 / np.max(np.abs(swing)) ** 2, t)
    frames = np.arange(5, len(t), 10)
    drive = InputSignal(
        "hub", "m", (0.0, 1e-3), hub + encoder * rng.standard_normal(len(t)), "linear", sigma=encoder
    )
    outputs = [
        OutputSignal(name, "m", t[frames], values[frames] + 5e-6 * rng.standard_normal(len(frames)))
        for name, values in (("tip", hub + swing), ("middle", hub + 0.6 * swing))
    ]
    return TimeRecord((drive,), tuple(outputs))
