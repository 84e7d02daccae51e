"""Which modes a controller could damp that sees the beam through a camera; nothing runs on an axis from here.

A controller sees a mode late: by half the exposure, by what camera and computer take, and its answer is held for a
frame. A model turns the known part of that back (the phase of a swing some milliseconds ahead is known), and leaves
two limits: frames must be fast enough to see the mode at all, and what is not known of delay and frequency turns
the answer against the swing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beam_ident.data.argument_checks import require_time
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel

MIN_MARGIN = math.radians(30.0)
"""Phase margin below which no controller is called safe."""
_TWO_SIDED = 1.96


@dataclass(frozen=True)
class DampableMode:
    """What a controller could do about one mode.

    Attributes
    ----------
    frequency_hz : float
    frames_per_period : float -- how often a swing is seen
    delay_phase : float -- by how much the swing goes on while the controller waits [rad]
    phase_margin_plain : float
        Of feedback of the measured rate without a model that looks ahead [rad]; below 0 it drives the mode.
    phase_margin : float -- with one, what is not known of delay and frequency taken away (95 %) [rad]
    own_decay, largest_decay : float
        Rate at which the mode decays by itself, and with the largest gain that keeps the margin [1/s].
    verdict : str
    is_dampable : bool
    """

    frequency_hz: float
    frames_per_period: float
    delay_phase: float
    phase_margin_plain: float
    phase_margin: float
    own_decay: float
    largest_decay: float
    verdict: str
    is_dampable: bool


def dampable_modes(
    model: ModalModel, *, delay_s: float, delay_sd_s: float, frame_rate_hz: float, exposure_s: float = 0.0
) -> tuple[DampableMode, ...]:
    """Return for every mode whether feedback through a camera could damp it, and with which margin.

    Parameters
    ----------
    model : ModalModel -- identified
    delay_s, delay_sd_s : float
        From the middle of an exposure until the axis has the answer, with its standard deviation [s].
    frame_rate_hz : float -- frames a second
    exposure_s : float -- [s]

    Notes
    -----
    The answer is held for a frame, on average half of one: ``tau = delay + 1 / (2 rate)``. A mode's envelope under
    delayed feedback of its rate obeys ``a' = -sigma a - g a(t - tau)``: its quickest decay without overshoot,
    ``1 / tau`` beside its own, comes with ``g = 1 / (e tau)`` at a phase margin of ``pi / 2 - 1 / e``. An error of
    the phase, of ``omega`` times that of the delay and ``tau`` times that of ``omega``, is lost from it.
    """
    require_time("delay_s", delay_s)
    require_time("delay_sd_s", delay_sd_s)
    require_time("exposure_s", exposure_s)
    if not (math.isfinite(frame_rate_hz) and frame_rate_hz > 0.0):
        raise EstimationError(f"frame_rate_hz is {frame_rate_hz!r}; expected a number above 0")
    tau = delay_s + 0.5 / frame_rate_hz
    if exposure_s > 1.0 / frame_rate_hz:
        raise EstimationError(
            f"exposure_s is {exposure_s:g}, longer than a frame at {frame_rate_hz:g} frames a second; expected less"
        )
    omegas, zetas, omega_sds, _ = model.modes()
    found = []
    for omega, zeta, omega_sd in zip(
        omegas.tolist(), zetas.tolist(), np.asarray(omega_sds).tolist(), strict=True
    ):
        frames = frame_rate_hz * 2.0 * math.pi / omega
        unknown = _TWO_SIDED * math.hypot(omega * delay_sd_s, tau * omega_sd)
        margin = 0.5 * math.pi - 1.0 / math.e - unknown
        # The box of the exposure weakens what is seen, and turns it round where it is longer than a period.
        seen = float(np.sinc(omega * exposure_s / (2.0 * math.pi)))
        if frames <= 2.0:
            verdict = f"not dampable: {frames:.2g} frames in a period show it at another frequency"
        elif margin < MIN_MARGIN:
            verdict = (
                f"not dampable: an uncertain delay leaves {math.degrees(margin):.0f} degrees of phase margin"
            )
        elif seen < 0.5:
            verdict = "not dampable: the exposure blurs most of it"
        else:
            verdict = f"dampable, in {1.0 / (zeta * omega + 1.0 / tau):.2g} s instead of {1.0 / (zeta * omega):.2g} s"
        found.append(
            DampableMode(
                omega / (2.0 * math.pi),
                frames,
                omega * tau,
                0.5 * math.pi - omega * tau,
                margin,
                zeta * omega,
                zeta * omega + 1.0 / tau,
                verdict,
                verdict.startswith("dampable"),
            )
        )
    return tuple(found)
