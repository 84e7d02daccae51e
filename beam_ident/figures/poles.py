"""Poles and zeros in the s plane with the ellipses in which they lie at 95 %."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.figures.canvas import COLOURS, MODEL, REFERENCE, axes_grid
from beam_ident.modal.model import ModalModel
from beam_ident.numerics.root_uncertainty import root_covariances
from beam_ident.transfer_function.model import TransferFunctionModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_REACH = 1.5  # times the farthest pole: zeros beyond it stand for what the model leaves out


def pole_zero_figure(model: ModalModel | TransferFunctionModel, common: float = 0.0) -> Figure:
    """Draw the poles of the upper half plane with 95 % ellipses, and the zeros, of a transfer function with theirs.

    The left panel shows where they are; the right panels look at the first six complex poles
    as closely as their ellipses need, relative to the estimate [rad/s].

    Parameters
    ----------
    model : ModalModel or TransferFunctionModel
    common : float -- relative standard uncertainty of all frequencies together, which the fit cannot know
    """
    poles, spreads = _poles(model)
    away = np.stack([poles.real, poles.imag], axis=1)
    spreads = spreads + common**2 * away[:, :, None] * away[:, None, :]
    upper = [(p, c) for p, c in zip(poles, spreads, strict=True) if p.imag >= 0.0]
    upper.sort(key=lambda item: abs(item[0]))
    close = [(p, c) for p, c in upper if p.imag > 0.0 and np.all(np.isfinite(c)) and np.trace(c) > 0.0][:6]
    figure, axes = axes_grid(1, 1 + len(close), (3.6 + 1.9 * len(close), 3.4))
    left = axes[0, 0]
    _mark(left, np.array([p for p, _ in upper]), "x", MODEL, "poles")
    for pole, spread in upper:
        _ellipse(left, pole, spread, MODEL)
    if isinstance(model, TransferFunctionModel) and len(model.numerator) > 1:
        n = model.n_poles
        numbers = slice(n, n + len(model.numerator))
        zeros, of_zeros = root_covariances(model.numerator, model.covariance[numbers, numbers])
        keep = zeros.imag >= 0.0
        _mark(left, zeros[keep], "o", REFERENCE, "zeros")
        for zero, spread in zip(zeros[keep], of_zeros[keep], strict=True):
            _ellipse(left, zero, spread, REFERENCE)
    if isinstance(model, ModalModel) and not model.further_inputs:
        farthest = _REACH * float(np.max(np.abs(poles)))
        for number, name in enumerate(model.output_names):
            zeros = model.zpk(name)[0]
            near = zeros[(zeros.imag >= 0.0) & (np.abs(zeros) < farthest)]
            _mark(left, near, "o", COLOURS[number % len(COLOURS)], f"zeros of {name}")
    left.set_xlabel("real part [rad/s]")
    left.set_ylabel("imaginary part [rad/s]")
    left.legend(loc="best", fontsize=8, frameon=False)
    for axis, (pole, spread) in zip(axes[0, 1:], close, strict=True):
        _mark(axis, np.zeros(1, dtype=complex), "x", MODEL, "")
        _ellipse(axis, 0.0, spread, MODEL)
        reach = 3.5 * np.sqrt(np.diag(spread))
        axis.set_xlim(-reach[0], reach[0])
        axis.set_ylim(-reach[1], reach[1])
        axis.set_title(f"about {pole.real:.4g} + {pole.imag:.5g}j", fontsize=8)
        axis.ticklabel_format(style="sci", scilimits=(-2, 3))
        axis.xaxis.get_offset_text().set_fontsize(7)
        axis.yaxis.get_offset_text().set_fontsize(7)
        axis.tick_params(labelsize=7)
        axis.locator_params(nbins=3)
    return figure


def _poles(model: ModalModel | TransferFunctionModel) -> tuple[ComplexArray, FloatArray]:
    if isinstance(model, TransferFunctionModel):
        n = model.n_poles
        return root_covariances(model.denominator, model.covariance[:n, :n])
    omega, zeta, n = model.natural_frequencies, model.damping_ratios, model.n_modes
    root = np.sqrt(1.0 - zeta**2)
    slopes = np.stack(
        [np.stack([-zeta, -omega], axis=1), np.stack([root, -omega * zeta / root], axis=1)], axis=1
    )
    own = np.stack([np.arange(n), n + np.arange(n)], axis=1)
    covariances = model.covariance[own[:, :, None], own[:, None, :]]
    return model.poles, np.asarray(slopes @ covariances @ np.swapaxes(slopes, 1, 2))


def _mark(axis: Any, points: ComplexArray, marker: str, colour: str, label: str) -> None:
    face = "none" if marker == "o" else colour
    axis.plot(points.real, points.imag, marker, color=colour, markerfacecolor=face, markersize=6, label=label)


def _ellipse(axis: Any, centre: complex, covariance: FloatArray, colour: str) -> None:
    if not np.all(np.isfinite(covariance)):
        return
    values, directions = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    circle = np.sqrt(chi_squared_isf(2, 0.05) * np.maximum(values, 0.0))[:, None] * np.stack(
        [np.cos(angle), np.sin(angle)]
    )
    x, y = directions @ circle
    axis.plot(centre.real + x, centre.imag + y, color=colour, linewidth=0.9)
