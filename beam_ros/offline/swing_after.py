"""The swing that a recorded move left: amplitudes of the modes at the end of its command, at every marker."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beam_ident.errors import IdentificationError
from beam_ident.excitation import Recipe, ShapedMove
from beam_ident.modal.model import ModalModel
from beam_ros.arrays import FloatArray
from beam_ros.bags.errors import BagError
from beam_ros.bags.reading import Bag
from beam_ros.errors import UsageError
from beam_ros.process.remote_paths import AnyPath

_BEFORE_S = 0.3
_MAX_REST_S = 3.0
"""Longer after the move a mode's frequency, as it is known, need not fit its swing any more."""


@dataclass(frozen=True, eq=False)
class SwingAfter:
    """What a move left.

    Attributes
    ----------
    output_names : tuple of str
    swings : ndarray, shape (n_outputs,) -- sum of the modes' amplitudes [m]
    mode_sds : ndarray, shape (n_outputs, n_modes) -- standard deviation of both parts of a mode's amplitude [m]
    times_s : ndarray, shape (n,) -- since the end of the command, some before it [s]
    deflections : ndarray, shape (n, n_outputs) -- from where the markers rest afterwards [m]
    """

    output_names: tuple[str, ...]
    swings: FloatArray
    mode_sds: FloatArray
    times_s: FloatArray
    deflections: FloatArray


def swing_after(path: AnyPath, model: ModalModel) -> SwingAfter:
    """Measure the swing after the shaped move of a bag.

    Parameters
    ----------
    path : Path or RemotePath -- a bag whose excitation is a ``shaped_move``
    model : ModalModel -- where the modes lie

    Raises
    ------
    BagError
        The bag is missing or damaged, or lacks displacements.
    UsageError
        Its excitation is no shaped move, or hardly a frame was taken after it.

    Notes
    -----
    Decaying cosines and sines of the model's poles, and a constant, are fitted to the rest after the move. What the
    exposure averages away of a mode is given back.
    """
    with Bag(path) as bag:
        bag.require("beam/displacement")
        bag.read("excitation/info", "beam/displacement")
        info, seen = bag.excitation_info() or {}, bag.displacements()
    try:
        recipe = Recipe.from_dict(info.get("recipe", {}))
    except IdentificationError as err:
        raise BagError(
            f"{path}: excitation/info holds no recipe ({err}); record the move with the suite"
        ) from err
    if not isinstance(recipe, ShapedMove):
        raise UsageError(f"{path}: its excitation is {recipe.kind}; expected a shaped_move")
    end_ns = int(info["start_ns"]) + round(recipe.move_end_s * 1e9)
    exposure_s = float(info.get("rig", {}).get("camera", {}).get("exposure", 0.0))
    times = (seen.stamps_ns - end_ns) * 1e-9
    rest = (times > exposure_s) & (times < min(recipe.dwell, _MAX_REST_S) - exposure_s)
    names = [name for name in model.output_names if name in seen.names]
    places = seen.positions[:, [seen.names.index(name) for name in names]]
    poles = model.poles
    n_columns = 2 * model.n_modes + 1
    waves = np.exp(np.outer(times, poles))
    columns = np.concatenate([waves.real, waves.imag, np.ones((len(times), 1))], axis=1)
    kept = np.sinc(poles.imag * exposure_s / (2.0 * math.pi))
    swings, sds, offsets = [], [], []
    for j in range(len(names)):
        own = rest & np.isfinite(places[:, j])
        if np.count_nonzero(own) < 2 * n_columns:
            raise UsageError(
                f"{path}: {np.count_nonzero(own)} frames show {names[j]} after the move; expected at least "
                f"{2 * n_columns}: rest longer (excitation.dwell)"
            )
        found, _, _, _ = np.linalg.lstsq(columns[own], places[own, j], rcond=None)
        left = places[own, j] - columns[own] @ found
        spread = np.diag(np.linalg.pinv(columns[own].T @ columns[own]))[: model.n_modes]
        noise = float(left @ left) / (np.count_nonzero(own) - n_columns)
        amplitudes = np.hypot(found[: model.n_modes], found[model.n_modes : -1]) / kept
        swings.append(float(np.sum(amplitudes)))
        sds.append(np.sqrt(noise * spread) / np.abs(kept))
        offsets.append(found[-1])
    shown = (times > -_BEFORE_S) & (times < recipe.dwell - exposure_s)
    return SwingAfter(
        tuple(names),
        np.array(swings, dtype=np.float64),
        np.array(sds, dtype=np.float64),
        np.asarray(times[shown], dtype=np.float64),
        np.asarray(places[shown] - np.array(offsets), dtype=np.float64),
    )
