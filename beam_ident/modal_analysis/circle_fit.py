"""One mode by its circle in the Nyquist plane (Kennedy and Pancu 1947).

Around a resonance the mobility of a viscously damped mode runs along a circle,

    Y = A j omega / (omega_0^2 - omega^2 + 2 j zeta omega_0 omega) + C

displaced by a constant C, which is what the other modes add.  Seen from the centre the angle
sweeps as ``theta_0 - 2 atan( (omega^2 - omega_0^2) / (2 zeta omega_0 omega) )``: the fit of the circle gives the
residue's size and direction, the fit of the sweep frequency and damping.  A look at a single
mode; where modes overlap, ``modal_analysis.analyse_modes`` separates them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import require_frequency_record
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.errors import EstimationError
from beam_ident.modal_analysis.stabilisation import ResponseForm, checked_form

_ITERATIONS = 50
_MIN_LINES = 5


@dataclass(frozen=True, eq=False)
class CircleFit:
    """A mode by its Nyquist circle.

    Attributes
    ----------
    natural_frequency, damping_ratio : float -- [rad/s], [-]
    natural_frequency_sd, damping_ratio_sd : float
        Standard deviations by the scatter of the points around the circle's motion.
    residue : complex -- A of ``A / (s - p) + conj(A) / (s - conj(p))`` of the receptance
    centre : complex
    radius : float -- of the circle in the plane of the mobility
    omegas : ndarray, shape (n,) -- lines used [rad/s]
    points : complex ndarray, shape (n,) -- mobility there
    roundness : float -- root mean square distance of the points from the circle over its radius
    converged : bool -- whether the fit of frequency and damping came to rest
    """

    natural_frequency: float
    damping_ratio: float
    natural_frequency_sd: float
    damping_ratio_sd: float
    residue: complex
    centre: complex
    radius: float
    omegas: FloatArray
    points: ComplexArray
    roundness: float
    converged: bool


def circle_fit(
    record: FrequencyRecord,
    near_hz: float,
    width_hz: float,
    form: ResponseForm = "receptance",
    output_name: str | None = None,
    input_name: str | None = None,
) -> CircleFit:
    """Fit the circle of a mode.

    Parameters
    ----------
    record : FrequencyRecord
    near_hz, width_hz : float
        Centre and whole width of the band around the resonance [Hz]: some two half-power bands.
    form : {"receptance", "mobility", "accelerance"}
    output_name, input_name : str or None -- None takes the first

    Raises
    ------
    EstimationError
        Fewer than five lines in the band, or points that do not run along a circle.
    """
    require_frequency_record(record)
    power = 1 - checked_form(form)
    if not (math.isfinite(near_hz) and math.isfinite(width_hz) and width_hz > 0.0):
        raise EstimationError(
            f"the band is {width_hz} Hz around {near_hz} Hz; expected finite numbers, the width > 0"
        )
    chosen = record.select(
        None if output_name is None else [output_name], None if input_name is None else [input_name]
    ).between(near_hz - 0.5 * width_hz, near_hz + 0.5 * width_hz)
    seen = np.isfinite(chosen.response[:, 0, 0])
    omegas = chosen.omegas[seen]
    if len(omegas) < _MIN_LINES:
        raise EstimationError(
            f"{len(omegas)} lines within {width_hz} Hz around {near_hz} Hz; a circle needs at least {_MIN_LINES}"
        )
    points = chosen.response[seen, 0, 0] * (1j * omegas) ** power
    centre, radius = _circle(points)
    # The sweep runs clockwise; unwrapped, it falls by at most a full turn.
    sweep = np.unwrap(np.angle(points - centre))
    omega, zeta, turn, converged = _sweep(omegas, sweep)
    # At resonance Y - C = A' / (2 zeta omega_0) for the numerator A' of j omega / d.
    strength = 2.0 * radius * np.exp(1j * turn) * 2.0 * zeta * omega
    residue = strength / (2j * omega * math.sqrt(1.0 - zeta**2))
    roundness = float(np.sqrt(np.mean((np.abs(points - centre) - radius) ** 2)) / radius)
    # Lines that share data scatter together: as many fewer of them speak.
    omega_sd, zeta_sd = math.sqrt(chosen.shared_lines) * _deviations(omegas, points, omega, zeta)
    zeta -= record.decay_rate / omega  # what an exponential window adds
    return CircleFit(
        omega, zeta, omega_sd, zeta_sd, complex(residue), centre, radius, omegas, points, roundness, converged
    )


def _circle(points: ComplexArray) -> tuple[complex, float]:
    """Return centre and radius by the algebraic fit ``|z|^2 = 2 Re(conj(c) z) + r^2 - |c|^2``."""
    middle = complex(np.mean(points))
    size = max(float(np.std(points)), 1e-300)
    z = (points - middle) / size
    matrix = np.stack([2.0 * z.real, 2.0 * z.imag, np.ones(len(z))], axis=1)
    (x, y, rest), _, rank, _ = np.linalg.lstsq(matrix, np.abs(z) ** 2, rcond=1e-10)
    square = rest + x * x + y * y
    if rank < 3 or not square > 0.0:
        raise EstimationError("the points of the band do not lie on a circle; centre the band on a resonance")
    return middle + size * complex(x, y), size * math.sqrt(square)


def _sweep(omegas: FloatArray, sweep: FloatArray) -> tuple[float, float, float, bool]:
    """Return natural frequency, damping ratio, angle at resonance and convergence of Gauss and Newton's method."""
    rate = np.gradient(sweep, omegas)
    place = int(np.argmin(rate))
    omega = float(omegas[place])
    # At resonance the angle falls by 2 / (zeta omega_0) per rad/s.
    zeta = min(max(2.0 / max(-float(rate[place]) * omega, 1e-300), 1e-6), 0.5)
    turn = float(sweep[place])
    cost, converged = math.inf, False
    for _ in range(_ITERATIONS):
        ratio = (omegas**2 - omega**2) / (2.0 * zeta * omega * omegas)
        error = sweep - (turn - 2.0 * np.arctan(ratio))
        slope = -2.0 / (1.0 + ratio**2)
        by_omega = slope * -(omegas**2 + omega**2) / (2.0 * zeta * omega**2 * omegas)
        by_zeta = slope * -ratio / zeta
        gradient = np.stack([by_omega, by_zeta, np.ones(len(omegas))], axis=1)
        step = np.linalg.lstsq(gradient / np.array([1.0 / omega, 1.0 / zeta, 1.0]), error, rcond=1e-12)[0]
        step = step * min(1.0, 0.3 / max(float(np.max(np.abs(step[:2]))), 1e-300))
        omega, zeta, turn = omega * (1.0 + step[0]), zeta * (1.0 + step[1]), turn + step[2]
        now = float(error @ error)
        converged = bool(abs(cost - now) <= 1e-14 * now and np.max(np.abs(step)) < 1e-10)
        if converged:
            break
        cost = now
    if not (omegas[0] <= omega <= omegas[-1]):
        raise EstimationError("the sweep of the points shows no resonance in the band; centre it on one")
    return omega, zeta, turn, converged


def _deviations(omegas: FloatArray, points: ComplexArray, omega: float, zeta: float) -> FloatArray:
    """Return the standard deviations of frequency and damping, size and centre being free as well."""
    shape = 1j * omegas / (omega**2 - omegas**2 + 2j * zeta * omega * omegas)
    ones = np.ones(len(omegas), dtype=complex)
    linear = np.stack([shape, ones], axis=1)
    found = np.linalg.lstsq(linear, points, rcond=None)[0]
    error, size = points - linear @ found, found[0]
    by_omega = -size * shape**2 / (1j * omegas) * (2.0 * omega + 2j * zeta * omegas)
    by_zeta = -size * shape**2 / (1j * omegas) * 2j * omega * omegas
    columns = np.stack([by_omega, by_zeta, shape, 1j * shape, ones, 1j * ones], axis=1)
    gradient = np.concatenate([columns.real, columns.imag])
    norms = np.linalg.norm(gradient, axis=0)
    inverse = np.linalg.pinv((gradient / norms).T @ (gradient / norms), rcond=1e-13)
    variance = float(np.vdot(error, error).real) / max(2 * len(omegas) - 6, 1)
    return np.asarray(np.sqrt(variance * np.diag(inverse)[:2]) / norms[:2])
