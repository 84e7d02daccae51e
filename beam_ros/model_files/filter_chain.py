"""A filter chain of ros2_controllers that takes the modes out of a set-point: a notch of second order for each.

The ``chained_filter_controller`` runs filters of the package ``filters`` one after the other. Each notch has zeros
where the mode, sampled at the controller's period T, has its poles ``e^(p T)``, and two poles at ``e^(-omega T)`` in
their place: the mode is cancelled, for the time that a mode without swinging needs to settle.
"""

from __future__ import annotations

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import WriteRequest

_TYPE = "filters/TransferFunctionFilterDouble"


def filter_chain_file(request: WriteRequest) -> bytes:
    """Return the parameter file of a controller that runs at the rig's ``hub.period``.

    Raises
    ------
    UsageError
        The model has no mode, or one that the controller is too slow for.
    """
    period, modes = request.rig.hub.period, request.model.modes
    if not modes:
        raise UsageError(f"{request.model.source}: has no mode; a notch needs one")
    lines = [
        f"# Notches at the modes of {request.model.source}, for a controller with a period of {period!r} s.",
        f"{request.target.stem}:",
        "  ros__parameters:",
        '    input_interface: "hub/position"  # yours',
        '    output_interface: "hub/filtered_position"',
        "    filter_chain:",
    ]
    for number, mode in enumerate(modes, 1):
        if mode.omega * period >= np.pi:
            raise UsageError(
                f"--ros2-filter: mode {number} at {mode.omega / (2.0 * np.pi):.4g} Hz is above half the rate of a "
                f"controller with hub.period {period:g} s; give a shorter one with -p hub.period:="
            )
        b, a = notch(mode.omega, mode.zeta, period)
        lines += [
            f"      filter{number}:",
            f"        name: mode_{number}",
            f"        type: {_TYPE}",
            "        params:",
            f"          a: {a.tolist()!r}",
            f"          b: {b.tolist()!r}",
        ]
    return ("\n".join(lines) + "\n").encode()


def notch(omega: float, zeta: float, period: float) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of input and output, shape (3,) each, of a notch with a gain of 1 at rest.

    Parameters
    ----------
    omega, zeta : float -- of the mode [rad/s]
    period : float -- of the samples [s]
    """
    pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    zero = np.exp(pole * period)
    b = np.array([1.0, -2.0 * zero.real, abs(zero) ** 2])
    slow = float(np.exp(-omega * period))
    a = np.array([1.0, -2.0 * slow, slow**2])
    return np.asarray(b * (np.sum(a) / np.sum(b))), a
