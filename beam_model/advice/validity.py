"""Where the theory in use errs by more than an identified mode shows, and what describes the beam better."""

from __future__ import annotations

import math

import numpy as np

from beam_model.arrays import FloatArray
from beam_model.continuum.still_air import MAX_REYNOLDS, air_load
from beam_model.dynamics.amplitude_laws import amplitude_law
from beam_model.galerkin.model import BeamModel

_VISIBLE = 1e-3  # relative, of a frequency
_LIGHT = 0.1  # damping ratio: a resonance is then 1 % below the natural frequency
_SLENDER = 0.5  # wave number of the mode times the strip's width (Van Eysden and Sader 2007)


def validity(model: BeamModel, n_modes: int, amplitude: float) -> tuple[str, ...]:
    """Return one sentence for every limit of the theory that a rig exceeds.

    Parameters
    ----------
    model : BeamModel
    n_modes : int
        How many modes are meant; no more than the model has.
    amplitude : float
        Of the tip, as far as it is bent [m].
    """
    n = min(n_modes, model.n_modes)
    return (*_bending(model, n), *_amplitude(model, n, amplitude), *_damping(model, n), *_air(model, n))


def _wave_numbers(model: BeamModel, n: int) -> FloatArray:
    """Return k of the first modes [1/m]: k^4 = rho omega^2/EI."""
    parameters = model.parameters
    scale = parameters.mass_per_length / parameters.flexural_rigidity
    return np.asarray((scale * model.basis.natural_frequencies[:n] ** 2) ** 0.25)


def _bending(model: BeamModel, n: int) -> list[str]:
    section = model.parameters.section
    if section is None:
        return []
    squares = (_wave_numbers(model, n) * section.gyration_radius) ** 2
    if model.parameters.theory == "timoshenko":
        # sqrt(k G A/(rho I)) over omega is 1/(k^2 r_g^2) sqrt(k G/E).
        near = squares * math.sqrt(section.shear_ratio)
        if near[-1] < 0.5:
            return []
        return [
            f"mode {int(np.argmax(near >= 0.5)) + 1} and above: the wavelength comes near the thickness of "
            f"{1000.0 * section.thickness:.3g} mm, where no theory of beams holds; trust the modes below"
        ]
    # Rotation and shear take k^2 r_g^2/2 (1 + E/(k G)) of a frequency, to first order (Timoshenko 1921).
    errors = 0.5 * squares * (1.0 + section.shear_ratio)
    if errors[-1] < _VISIBLE:
        return []
    first = int(np.argmax(errors >= _VISIBLE))
    wave = 2.0 * math.pi / _wave_numbers(model, n)[-1]
    return [
        f"mode {first + 1} and above: Euler and Bernoulli's theory puts mode {n} about {100.0 * errors[-1]:.2g} % "
        f"too high, its wavelength being {wave / section.thickness:.3g} thicknesses; take beam.theory:=timoshenko"
    ]


def _amplitude(model: BeamModel, n: int, amplitude: float) -> list[str]:
    for mode in range(n):
        if model.pole_pairs[mode, 0].imag == 0.0:
            continue
        law = amplitude_law(model, mode, model.parameters.length)
        change = law.hardening * amplitude**2
        if abs(change) >= _VISIBLE:
            limit = math.sqrt(_VISIBLE / abs(law.hardening))
            return [
                f"mode {mode + 1}: a swing of {1000.0 * amplitude:.3g} mm at the tip changes its frequency by "
                f"{100.0 * change:+.2g} %, as large deflections do; below {1000.0 * limit:.2g} mm it is 0.1 %"
            ]
    return []


def _damping(model: BeamModel, n: int) -> list[str]:
    ratios = model.damping_ratios[:n]
    heavy = [str(k + 1) for k in np.flatnonzero(ratios >= _LIGHT)]
    if not heavy:
        return []
    what = "mode" if len(heavy) == 1 else "modes"
    lines = [
        f"{what} {', '.join(heavy)}: damping of {100.0 * ratios.max():.3g} % and less moves resonances away from the "
        "natural frequencies and couples modes; read the responses (--plot), not the table alone"
    ]
    if model.parameters.damping.modal_ratio(n - 1) >= _LIGHT:
        lines.append(
            "a damping ratio given for each mode describes light damping only; describe heavy damping by "
            "viscous_damping, air_damping or internal_damping"
        )
    return lines


def _air(model: BeamModel, n: int) -> list[str]:
    parameters = model.parameters
    section, air = parameters.section, parameters.air
    if section is None or air is None:
        return []
    load = air_load(parameters, model.natural_frequencies[:n])
    # Vortices resist a swing a with 4/(3 pi) rho_a C_d b omega a per length, C_d = 8 KC^(-1/3) (``AirDrag``).
    along = load.damping[0] / (air.density * section.width * model.natural_frequencies[0])
    share = 3.0 * math.pi / 32.0 * along * (2.0 * math.pi / section.width) ** (1.0 / 3.0)
    lines = [
        f"still air: above {1000.0 * share**1.5:.2g} mm of swing vortices resist mode 1 more than viscosity does; "
        "simulation.drag_coefficient describes them"
    ]
    if load.reynolds[-1] > MAX_REYNOLDS:
        first = int(np.argmax(load.reynolds > MAX_REYNOLDS))
        lines.append(
            f"still air: from mode {first + 1} on the Reynolds number is above {MAX_REYNOLDS:.0e}, beyond Sader's "
            "formula; what it gives there is that of the limit"
        )
    widths = _wave_numbers(model, n) * section.width
    if widths[-1] > _SLENDER:
        first = int(np.argmax(widths > _SLENDER))
        lines.append(
            f"still air: from mode {first + 1} on the strip is wide against its wavelength (2 pi b/lambda = "
            f"{widths[first]:.2g}), so that less air moves along than the theory says"
        )
    if section.width < 10.0 * section.thickness:
        lines.append(
            f"still air: the strip is only {section.width / section.thickness:.2g} times as wide as thick; the "
            "theory is that of a thin blade"
        )
    return lines
