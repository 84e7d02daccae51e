"""The power spectrum that tells most under limits: a convex design over lines.

Over a record much longer than a period, lines of independent phases add their information, and their powers add up in
whatever is limited:

    I(p) = sum_k p_k I_k,        sum_k p_k g_qk <= 1 for every limited quantity q

so that D-, A- and c-optimality are convex in the powers p (Mehra, IEEE Trans. Autom. Control 19, 1974; Goodwin and
Payne, Dynamic System Identification, 1977). The powers follow by multiplicative updates, line by line by the ratio of
what it tells to what it costs, and the prices of the limits by how far each is used.

Lines half a bandwidth from its resonance show a lightly damped mode best, and nobody knows that place before the
experiment. The criterion is therefore averaged over draws of the model (Chaloner and Verdinelli, Statist. Sci.
10, 1995), and what a line tells over the width of the record's own lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.design.criteria import Criterion
from beam_ident.design.limits import ExcitationLimits, response_to_drive
from beam_ident.design.precision import Observation
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure

_LINES_OF_A_BAND = 3.0  # candidates in a half-power band, where the record tells them apart
_REACH = 1.5  # half-power bands on both sides of where a mode may lie
_MOST_OF_A_MODE = 40
_BACKGROUND = 24  # candidates over the whole band, at equal ratios
_OFFSETS = np.array([-2.5, -1.5, -1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.5])
_ITERATIONS = 300
_PRICE_STEP = 0.2
_NEGLIGIBLE = 2e-4  # of all power in the dearest quantity: a line below is left out
_BEAT = 2.0  # lines of a record: seen slower than this, a folded line is taken for a drift


def candidate_lines(
    models: Sequence[ModalModel], band_hz: tuple[float, float], duration_s: float, rate_hz: float
) -> FloatArray:
    """Return the frequencies that lines may have, increasing [Hz].

    Parameters
    ----------
    models : sequence of ModalModel -- the model and draws of what it may be
    band_hz : tuple of float
    duration_s : float -- of the excitation
    rate_hz : float -- of the camera
    """
    low, high = band_hz
    lines = [np.geomspace(low, high, _BACKGROUND)]
    nominal = models[0]
    places = np.array([model.frequencies_hz for model in models])
    for k in range(nominal.n_modes):
        width = 2.0 * abs(nominal.damping_ratios[k]) * nominal.frequencies_hz[k]
        reach = max(_REACH * width, 1.0 / duration_s)
        first, last = np.min(places[:, k]) - reach, np.max(places[:, k]) + reach
        step = max(1.0 / duration_s, width / _LINES_OF_A_BAND, (last - first) / _MOST_OF_A_MODE)
        centre = nominal.frequencies_hz[k]
        count = np.arange(np.floor((first - centre) / step), np.ceil((last - centre) / step) + 1)
        lines.append(centre + step * count)
    # A line of the background too near to one of a mode would only beat with it.
    found = np.unique(np.concatenate(lines[1:]))
    apart = np.min(np.abs(lines[0][:, None] - found[None, :]), axis=1)
    found = np.sort(np.concatenate([found, lines[0][apart > 1.0 / duration_s]]))
    found = found[(found >= low) & (found <= high)]
    seen = np.abs(found - rate_hz * np.round(found / rate_hz))
    return np.asarray(found[seen > _BEAT / duration_s])


def _smeared(lines_hz: FloatArray, duration_s: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies around every line [rad/s], (n_lines, n_offsets), and the record's weight of each."""
    weights = np.square(np.sinc(_OFFSETS)) * np.gradient(_OFFSETS) + 1e-12
    around = np.maximum(lines_hz[:, None] + _OFFSETS / duration_s, 0.1 * lines_hz[:, None])
    return 2.0 * np.pi * around, weights / np.sum(weights)


def _slopes_of_response(model: ModalModel, omegas: FloatArray, scale: float) -> ComplexArray:
    """Return the slopes of all outputs' responses to the recipe's acceleration, (n, n_outputs, n_parameters).

    By log omega and log zeta of all modes, the latency, and gain, residual term and residues of every output.
    """
    structure = ModalStructure(model.structure)
    s = 1j * omegas
    front = scale * (-np.ones_like(s) if structure.is_motion else s**structure.differentiations)
    n, m = model.n_modes, len(model.output_names)
    omega, zeta = model.natural_frequencies, model.damping_ratios
    modes = 1.0 / (s[:, None] ** 2 + 2.0 * zeta * omega * s[:, None] + omega**2)
    by_omega = -front[:, None] * modes**2 * (2.0 * zeta * s[:, None] + 2.0 * omega) * omega
    by_zeta = -front[:, None] * modes**2 * 2.0 * omega * s[:, None] * zeta
    result = np.zeros((len(s), m, 2 * n + 1 + m * (n + 2)), dtype=np.complex128)
    result[:, :, :n] = by_omega[:, None, :] * model.residues
    result[:, :, n : 2 * n] = by_zeta[:, None, :] * model.residues
    result[:, :, 2 * n] = -s[:, None] * scale * response_to_drive(model, omegas)
    power = -2 if structure.is_motion else structure.differentiations - 2
    direct = scale * s**power if structure.has_direct else np.zeros_like(s)
    for j in range(m):
        here = 2 * n + 1 + j * (n + 2)
        result[:, j, here] = direct
        result[:, j, here + 1] = front
        result[:, j, here + 2 : here + 2 + n] = front[:, None] * modes
    return result


def line_information(
    model: ModalModel,
    lines_hz: FloatArray,
    limits: ExcitationLimits,
    duration_s: float,
    observation: Observation,
) -> FloatArray:
    """Return what a line of mean square 1 (m/s^2)^2 tells, shape (n_lines, n_parameters, n_parameters).

    Parameters
    ----------
    model : ModalModel
    lines_hz : ndarray, shape (n_lines,) -- [Hz]
    limits : ExcitationLimits -- gives the drive's scale and the hold
    duration_s : float -- of the excitation [s]
    observation : Observation

    Notes
    -----
    Parameters are log omega and log zeta of all modes, the latency, then gain, residual term and residues of every
    output. Of N frames, a line of effective value 1 that moves output j by H_j tells
    ``N Re(dH^H S^-1 dH)`` with ``S = diag(sigma_j^2) + s^2 T f G G^H``: white noise of standard deviation s on the
    input's samples, T apart, reaches the outputs through their responses G to the input, f frames a second.
    """
    omegas, weights = _smeared(lines_hz, duration_s)
    slopes = _slopes_of_response(model, omegas.ravel(), limits.scale)
    blur = np.sinc(omegas.ravel() * observation.exposure_s / (2.0 * np.pi))
    per_noise = blur[:, None] / observation.noise_of(model.output_names)
    slopes *= per_noise[:, :, None]
    power = ModalStructure(model.structure).driving_power
    passed = response_to_drive(model, omegas.ravel()) * (omegas.ravel() ** power)[:, None] * per_noise
    passed *= observation.input_sd * math.sqrt(limits.period_s * observation.rate_hz)
    size = np.maximum(np.sum(np.abs(passed) ** 2, axis=1), 1e-300)
    # (1 + g g^H)^(-1/2) takes a part of what lies along g, and nothing else.
    taken = (1.0 - 1.0 / np.sqrt(1.0 + size)) / size
    slopes -= (taken[:, None] * passed)[:, :, None] * np.einsum("oj,ojp->op", passed.conj(), slopes)[:, None]
    slopes *= np.sqrt(np.tile(weights, len(lines_hz)))[:, None, None]
    stacked = slopes.reshape(len(lines_hz), -1, slopes.shape[2])
    stacked = np.concatenate([stacked.real, stacked.imag], axis=1)
    frames = duration_s * observation.rate_hz
    return np.asarray(frames * (stacked.transpose(0, 2, 1) @ stacked))


def left_by_input_noise(
    model: ModalModel,
    lines_hz: FloatArray,
    limits: ExcitationLimits,
    duration_s: float,
    observation: Observation,
) -> FloatArray:
    """Return the share of what a line tells of the poles that the input's noise leaves, shape (n_lines,)."""
    n = 2 * model.n_modes
    told = [
        np.einsum("kii->k", line_information(model, lines_hz, limits, duration_s, own)[:, :n, :n])
        for own in (observation, replace(observation, input_sd=0.0))
    ]
    return np.asarray(told[0] / told[1])


def optimal_powers(
    criterion: Criterion,
    models: Sequence[ModalModel],
    lines_hz: FloatArray,
    limits: Sequence[ExcitationLimits],
    crests: FloatArray,
    duration_s: float,
    observation: Observation,
) -> FloatArray:
    """Return the mean squares of the acceleration of all lines [(m/s^2)^2], 0 where a line is not worth its price.

    Parameters
    ----------
    criterion : Criterion
    models : sequence of ModalModel -- the model and draws of what it may be
    lines_hz : ndarray, shape (n_lines,) -- candidates
    limits : sequence of ExcitationLimits -- of every model
    crests : ndarray, shape (n_quantities,) -- peak over effective value that each limited quantity will have
    duration_s : float -- of the excitation
    observation : Observation
    """
    told = np.array([line_information(own, lines_hz, limits[0], duration_s, observation) for own in models])
    smeared, weights = _smeared(lines_hz, duration_s)
    costs = np.mean(
        [
            np.einsum("koq,o->kq", own.gains(smeared.ravel()).reshape(*smeared.shape, -1), weights)
            for own in limits
        ],
        axis=0,
    )
    costs = costs * np.square(crests)
    interest = _interest(criterion, models[0])
    # All parameters in a scale of their own, so that what is small is not lost.
    size = np.sqrt(np.maximum(np.einsum("dkii->i", told), 1e-300))
    told /= np.outer(size, size)
    interest = interest / size[:, None]
    n_lines, n_quantities = costs.shape
    powers = np.full(n_lines, 1.0)
    powers /= np.max(powers @ costs)
    prices = np.full(n_quantities, 1.0 / n_quantities)
    exponent = 1.0 if criterion.kind == "D" else 0.5
    latest = np.zeros_like(powers)
    for turn in range(_ITERATIONS):
        slopes = criterion.slopes(np.tensordot(told, powers, (1, 0)), told, interest)
        price = costs @ prices
        powers = powers * (np.maximum(slopes, 0.0) / price) ** exponent
        used = powers @ costs
        powers /= np.max(used)
        prices *= np.maximum(used / np.max(used), 1e-6) ** _PRICE_STEP
        prices /= np.sum(prices)
        if turn >= _ITERATIONS // 2:
            latest += powers
    powers = latest / np.max(latest @ costs)
    return np.asarray(np.where(powers * (costs @ prices) > _NEGLIGIBLE, powers, 0.0))


def _interest(criterion: Criterion, model: ModalModel) -> FloatArray:
    """Return the combinations of the parameters of ``line_information`` that count."""
    n = model.n_modes
    size = len(model.parameter_names) - 1
    if criterion.kind != "c":
        return np.eye(size)[:, : 2 * n]
    place = criterion.place(model)  # the clock's rate stands after the latency
    return np.eye(size)[:, [place if place <= 2 * n else place - 1]]
