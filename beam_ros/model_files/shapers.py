"""Lines for the input shapers of printers: frequency and damping ratio of the first mode, with their intervals."""

from __future__ import annotations

import math

from beam_ident.report.evidence import ModeRow
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import WriteRequest

_COVERED = 1.959963984540054  # standard deviations either way: 95 %


def klipper_file(request: WriteRequest) -> bytes:
    """Return the section of Klipper's ``printer.cfg``."""
    mode = _first_mode(request)
    lines = [
        *_remarks(request, mode, "#"),
        "# For the axis y the letters are _y.",
        "[input_shaper]",
        f"shaper_freq_x: {_hertz(mode)!r}",
        f"damping_ratio_x: {mode.zeta!r}",
    ]
    return ("\n".join(lines) + "\n").encode()


def marlin_file(request: WriteRequest) -> bytes:
    """Return the command M593 of Marlin."""
    mode = _first_mode(request)
    lines = [
        *_remarks(request, mode, ";"),
        "; For the axis Y the letter is Y.",
        f"M593 X F{_hertz(mode)!r} D{mode.zeta!r}",
    ]
    return ("\n".join(lines) + "\n").encode()


def _first_mode(request: WriteRequest) -> ModeRow:
    if not request.model.modes:
        raise UsageError(f"{request.model.source}: has no mode; an input shaper needs one")
    mode = request.model.modes[0]
    if not 0.0 <= mode.zeta < 1.0:
        raise UsageError(
            f"{request.model.source}: the damping ratio of mode 1 is {mode.zeta:.3g}; an input shaper takes 0 to 1. "
            "Record a longer free decay and identify again"
        )
    return mode


def _hertz(mode: ModeRow) -> float:
    return mode.omega / (2.0 * math.pi)


def _remarks(request: WriteRequest, mode: ModeRow, mark: str) -> list[str]:
    """Return where the numbers come from and how well they are known."""
    turn = 2.0 * math.pi
    return [
        f"{mark} Mode 1 of {request.model.source}.",
        f"{mark} Natural frequency {_hertz(mode):.8g} Hz, {_interval(mode.omega / turn, mode.omega_sd / turn)} Hz.",
        f"{mark} Damping ratio {mode.zeta:.8g}, {_interval(mode.zeta, mode.zeta_sd)}.",
    ]


def _interval(value: float, sd: float) -> str:
    if not sd > 0.0:
        return "its interval is not known"
    return f"95 % from {value - _COVERED * sd:.8g} to {value + _COVERED * sd:.8g}"
