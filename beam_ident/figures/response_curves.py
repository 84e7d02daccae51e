"""Frequency responses of models of any kind, path by path, with what is known of their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.modal.model import ModalModel
from beam_ident.subspace.model import SubspaceModel
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.multi_input_model import MultiInputModel

_NEAR = np.linspace(-8.0, 8.0, 121)  # half-widths about a resonance, so that its peak is not cut off


@dataclass(frozen=True, eq=False)
class ResponseCurve:
    """A model's response from one input to one output.

    Attributes
    ----------
    input_name, output_name : str
    omegas : ndarray, shape (n,) -- [rad/s]
    response : complex ndarray, shape (n,)
    magnitude_sd : ndarray, shape (n,) -- NaN where the model states no uncertainty
    label : str -- whose response it is; empty where there is one model only
    """

    input_name: str
    output_name: str
    omegas: FloatArray
    response: ComplexArray
    magnitude_sd: FloatArray
    label: str = ""

    @property
    def frequencies_hz(self) -> FloatArray:
        """Frequencies [Hz]."""
        return np.asarray(self.omegas / (2.0 * np.pi))


def response_curves(model: Any, omegas: FloatArray, label: str = "") -> tuple[ResponseCurve, ...]:
    """Return a model's response on every path; nothing of a model that has none.

    Parameters
    ----------
    model : a model of any kind
    omegas : ndarray, shape (n,) -- positive frequencies [rad/s]
    label : str -- whose response it is
    """
    if isinstance(model, ModalModel):
        found = []
        for path in model.paths:
            whole = path.frequency_response(omegas)
            found += [
                ResponseCurve(
                    path.input_name, name, omegas, whole.response[:, j], whole.magnitude_sd[:, j], label
                )
                for j, name in enumerate(path.output_names)
            ]
        return tuple(found)
    if isinstance(model, TransferFunctionModel):
        response, sd = model.frequency_response(omegas)
        return (ResponseCurve(model.input_name, model.output_name, omegas, response, sd, label),)
    if isinstance(model, MultiInputModel):
        paths = [model.path(name) for name in model.input_names]
        return tuple(curve for path in paths for curve in response_curves(path, omegas, label))
    if isinstance(model, SubspaceModel):
        s = 1j * omegas
        unknown = np.full(len(omegas), np.nan)
        return tuple(
            ResponseCurve(
                drive,
                name,
                omegas,
                np.polyval(model.numerators[j, i], s) / np.polyval(model.denominator, s),
                unknown,
                label,
            )
            for j, name in enumerate(model.output_names)
            for i, drive in enumerate(model.input_names)
        )
    return ()


def drawing_lines(models: tuple[Any, ...], low: float, high: float, n_points: int = 1200) -> FloatArray:
    """Return frequencies [rad/s] from ``low`` to ``high``, close together about every resonance of the models."""
    near = []
    for model in models:
        if hasattr(model, "modes"):
            omegas, zetas, _, _ = model.modes()
            width = np.maximum(np.abs(zetas), 1e-4)
            near.append((omegas[:, None] * (1.0 + width[:, None] * _NEAR)).ravel())
    lines = np.unique(np.concatenate([np.geomspace(low, high, n_points), *near]))
    return np.asarray(lines[(lines >= low) & (lines <= high)])
