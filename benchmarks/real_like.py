"""Records of a plant that no model of the library describes, as every real plant is.

A force drives four modes, of which a model of six poles lacks the fourth.  The first mode stiffens with the cube of
its displacement and rubs.  What is measured has noise of a colour, which in a closed loop comes back in the force.
The equation of motion is integrated here, in steps of a tenth of a sample, apart from the library.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from beam_ident import InputSignal, OutputSignal, TimeRecord
from beam_ident.arrays import FloatArray

PERIOD_S = 0.01
_SUBSTEPS = 10
OMEGAS = 2.0 * np.pi * np.array([1.7, 7.3, 16.0, 31.0])  # [rad/s]
ZETAS = np.array([0.03, 0.012, 0.01, 0.008])
RESIDUES = np.array([1.0, -0.7, 0.5, 0.35]) * OMEGAS**1.5  # output for a unit of displacement
_CUBIC = 0.02  # of the linear stiffness, at the root mean square of the displacement
_FRICTION = 0.02  # of the root mean square of the force
_STICTION = 0.1  # of the root mean square of the velocity: below it friction is nearly viscous
_NOISE = 0.02  # of the output's standard deviation
_FEEDBACK = 0.3  # force for a standard deviation of the output


def real_like_record(seed: int, n_samples: int = 4096, is_loop: bool = False) -> TimeRecord:
    """Return a record from rest of a plant with weak nonlinearities, seen through noise of a colour.

    Parameters
    ----------
    seed : int
    n_samples : int
    is_loop : bool -- whether the force counters what was measured a sample before
    """
    rng = np.random.default_rng([seed, 4096])
    reference = lfilter([1.0], [1.0, -0.6], rng.standard_normal(n_samples).repeat(2)[:n_samples])
    reference /= np.std(reference)
    noise = lfilter([1.0], [1.0, -1.6, 0.7], rng.standard_normal(n_samples + 200))[200:]
    # The linear plant, without noise and loop, shows how large displacement and output are.
    output, places, _ = _driven(reference, np.zeros(n_samples), 0.0, math.inf)
    size = float(np.std(output))
    noise *= _NOISE * size / np.std(noise)
    gain = _FEEDBACK / size if is_loop else 0.0
    output, _, forces = _driven(reference, noise, gain, float(np.std(places)))
    drive = InputSignal("u", "N", (0.0, PERIOD_S), forces, "zoh")
    return TimeRecord((drive,), (OutputSignal("y", "m", (0.0, PERIOD_S), output),))


def _driven(
    reference: FloatArray, noise: FloatArray, gain: float, spread: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what is measured, displacements of the first mode, and forces, at all samples.

    ``spread`` is the displacement at which the nonlinearities have their stated sizes; infinity leaves them out.
    """
    ringing = OMEGAS * np.sqrt(1.0 - ZETAS**2)
    poles = -ZETAS * OMEGAS + 1j * ringing
    # z' = p z + a has displacement Im z / w_d and velocity Im(p z) / w_d; a is held through each step.
    decay = np.exp(poles * PERIOD_S / _SUBSTEPS)
    moved = (decay - 1.0) / poles
    stiffening, turning = _CUBIC * OMEGAS[0] ** 2 / spread**2, _STICTION * OMEGAS[0] * spread
    states = np.zeros(len(poles), dtype=np.complex128)
    output, places, forces = np.empty((3, len(reference)))
    for k, wanted in enumerate(reference):
        output[k] = RESIDUES @ (states.imag / ringing) + noise[k]
        places[k] = states[0].imag / ringing[0]
        forces[k] = wanted - gain * (output[k - 1] if k else 0.0)
        for _ in range(_SUBSTEPS):
            place, speed = states[0].imag / ringing[0], (poles[0] * states[0]).imag / ringing[0]
            states = decay * states + moved * forces[k]
            states[0] -= moved[0] * (stiffening * place**3 + _FRICTION * math.tanh(speed / turning))
    return output, places, forces
