"""Phases of lines that keep every limited quantity low at once, from rest to the end of the record.

The crest factor of one signal says nothing of a tip that rings up while the travel is still small. So the norm that
is minimised runs over all limited quantities and all instants, each in units of its limit: the largest of them
decides how loud the excitation may be.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from beam_ident.arrays import FloatArray
from beam_ident.design.limits import ExcitationLimits
from beam_ident.excitation.crest_optimisation import schroeder_phases
from beam_ident.excitation.multisine import ShapedMultisine

_NORMS = (4, 8, 16, 32, 64)
_ITERATIONS = 30
_INSTANTS = 4096  # of each quantity that are looked at; the level is found from all
_PLACE_SEED = 1
_FAR = 0.25  # of the largest effective value: a quantity below cannot become the limiting one


class LimitedLines:
    """What every line by itself does to the limited quantities of an experiment.

    Parameters
    ----------
    recipe : ShapedMultisine -- its amplitudes and phases do not matter
    limits : ExcitationLimits
    """

    def __init__(self, recipe: ShapedMultisine, limits: ExcitationLimits) -> None:
        sines: list[FloatArray] = []
        cosines: list[FloatArray] = []
        places: FloatArray | slice = slice(None)
        for frequency in recipe.frequencies:
            for found, phase in ((sines, 0.0), (cosines, 0.5 * np.pi)):
                alone = ShapedMultisine(
                    (frequency,), (1.0,), (phase,), 1.0, recipe.duration, recipe.fade, recipe.still
                )
                values = limits.over_time(alone.sample(limits.period_s).accelerations)
                if isinstance(places, slice) and values.shape[1] > _INSTANTS:
                    # At random: a regular grid would miss the peaks of lines that it folds.
                    rng = np.random.default_rng(_PLACE_SEED)
                    places = np.sort(rng.choice(values.shape[1], _INSTANTS, replace=False))
                found.append(values[:, places].astype(np.float32))
        self._sine = np.stack(sines, axis=-1)
        self._cosine = np.stack(cosines, axis=-1)

    def best_phases(self, amplitudes: FloatArray) -> FloatArray:
        """Return the phases of the lowest peak in units of the limits [rad], shape (n_lines,).

        Parameters
        ----------
        amplitudes : ndarray, shape (n_lines,) -- effective values of the lines' accelerations [m/s^2]

        Notes
        -----
        L_p norms with p = 4, 8, .. 64 in turn, from Schroeder's phases, as Guillaume, Schoukens, Pintelon and Kollar
        do for one signal (IEEE Trans. Instrum. Meas. 40, 1991).
        """
        powers = np.mean(np.square(self._sine) + np.square(self._cosine), axis=1) @ np.square(amplitudes)
        kept = np.sqrt(powers) > _FAR * np.sqrt(np.max(powers))
        n = len(amplitudes)
        sine = (self._sine[kept] * amplitudes.astype(np.float32)).reshape(-1, n)
        cosine = (self._cosine[kept] * amplitudes.astype(np.float32)).reshape(-1, n)

        def values(phases: FloatArray) -> FloatArray:
            found = sine @ np.cos(phases).astype(np.float32) + cosine @ np.sin(phases).astype(np.float32)
            return np.asarray(found, dtype=np.float64)

        def norm(phases: FloatArray, power: int) -> tuple[float, FloatArray]:
            x = values(phases)
            peak = float(np.max(np.abs(x)))
            scaled = x / peak
            # Of p = 2^k: x^(p - 1) = x x^2 x^4 .., some ten times quicker than a power.
            lower, square = scaled.copy(), scaled
            for _ in range(power.bit_length() - 2):
                square = square * square
                lower *= square
            total = float(np.mean(lower * scaled))
            pull = (lower / len(x)).astype(np.float32)
            slope = np.cos(phases) * (pull @ cosine) - np.sin(phases) * (pull @ sine)
            return peak * total ** (1.0 / power), np.asarray(total ** (1.0 / power - 1.0) * slope)

        phases = schroeder_phases(amplitudes)
        best, lowest = phases, float(np.max(np.abs(values(phases))))
        for power in _NORMS:
            options = {"maxiter": _ITERATIONS, "gtol": 1e-12, "ftol": 1e-9}
            found = minimize(norm, phases, args=(power,), jac=True, method="L-BFGS-B", options=options)
            phases = np.asarray(found.x, dtype=np.float64)
            peak = float(np.max(np.abs(values(phases))))
            if peak < lowest:
                best, lowest = phases, peak
        return np.asarray(np.mod(best, 2.0 * np.pi))
