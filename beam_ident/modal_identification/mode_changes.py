"""What outputs say of modes whose natural frequencies change while they are recorded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.mode_change import ModeChange, changes_of, over_swing, over_time
from beam_ident.modal.regression import ModalRegression

_TURN = (
    1e-3  # radians by which a difference turns a phase at most: its square is what it is wrong by, as a share
)


def possible_changes(regression: ModalRegression, fit: ModalFit, modes: Sequence[int]) -> list[ModeChange]:
    """Return how some modes might change, over time and over their swing, by a share of nothing yet.

    Parameters
    ----------
    regression : ModalRegression -- of one record
    fit : ModalFit
    modes : sequence of int
    """
    course = over_time(*regression.stamps_span_s)
    found = [ModeChange("time", omega, 0.0, course) for omega in fit.omegas[list(modes)].tolist()]
    return [*found, *(moved_on(replace(own, over="swing"), regression, fit) for own in found)]


def moved_on(change: ModeChange, regression: ModalRegression, fit: ModalFit) -> ModeChange:
    """Return a change with the frequency and the swing that a fit shows now."""
    mode = change.mode_of(fit.omegas)
    omega = float(fit.omegas[mode])
    if change.over == "time":
        return replace(change, omega=omega)
    plain = regression.with_own_columns({})
    blocks = plain.blocks(fit.omegas, fit.zetas, fit.clock, gradients=True)
    best, highest = np.empty(0), 0.0
    for j, (number, found) in enumerate(zip(plain.block_of, fit.coefficients, strict=True)):
        block = blocks[number]
        own = block.mode_columns[mode]
        assert block.by_time is not None
        motion, speed = block.matrix[:, own] @ found[own], block.by_time[:, own] @ found[own] / omega
        squares = np.square(plain.row_levels(j)) * (np.square(motion) + np.square(speed))
        if float(np.max(squares)) > highest:
            output, best, highest = j, squares, float(np.max(squares))
    if not highest:
        return change
    course, begins, swing = over_swing(plain.times[output], best, 2.0 * math.pi / omega, plain.margin_s)
    return replace(change, omega=omega, course=course, begins=begins, swing=swing)


def change_columns(
    regression: ModalRegression, fit: ModalFit, asked: Sequence[ModeChange]
) -> list[FloatArray]:
    """Return of every output the derivatives of the model by the share of some changes, (n_rows, n_asked), unweighed.

    Parameters
    ----------
    regression : ModalRegression -- with the changes that are known
    fit : ModalFit
    asked : sequence of ModeChange

    Notes
    -----
    Central differences of the response, which is exact.
    """
    plain = regression.with_own_columns({})
    known = changes_of(plain.structure.changes, fit.omegas)
    columns = []
    for change in asked:
        mode = change.mode_of(fit.omegas)
        step = _TURN / (float(fit.omegas[mode]) * plain.duration_s)
        share = known[mode].share if mode in known and known[mode].over == change.over else 0.0
        either = [
            _modelled(
                plain.with_changes(
                    (
                        *(own for k, own in known.items() if k != mode),
                        replace(change, omega=float(fit.omegas[mode]), share=share + sign * step),
                    )
                ),
                fit,
            )
            for sign in (1.0, -1.0)
        ]
        columns.append([(one - other) / (2.0 * step) for one, other in zip(*either, strict=True)])
    return [
        np.stack([own[j] for own in columns], axis=1) if columns else np.empty((len(values), 0))
        for j, values in enumerate(plain.values)
    ]


def _modelled(regression: ModalRegression, fit: ModalFit) -> list[FloatArray]:
    """Return what a fit says at the stamps of every output, unweighed."""
    parts: list[list[FloatArray]] = [[] for _ in fit.coefficients]
    for piece in regression.pieces:
        blocks = piece.blocks(fit.omegas, fit.zetas, fit.clock, gradients=False)
        for j, (number, found) in enumerate(zip(piece.block_of, fit.coefficients, strict=True)):
            matrix = blocks[number].matrix
            parts[j].append(matrix @ found[: matrix.shape[1]] * piece.row_levels(j))
    return [np.concatenate(own) for own in parts]
