"""A model for MATLAB, Octave and SciPy: a MAT file of version 5."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from scipy.io import savemat

from beam_ros.arrays import FloatArray
from beam_ros.model_files.formats import WriteRequest


def mat_file(request: WriteRequest) -> bytes:
    """Return the file.

    Notes
    -----
    ``ss(A, B, C, D)`` is the system without delays; ``num{j, k}`` over ``den{j, k}`` with ``delays_s(j, k)`` is the
    path from input k to output j. ``covariance`` is that of ``parameters``, named in ``parameter_names``.
    """
    model = request.model
    paths = model.paths
    content = {
        "A": model.transition,
        "B": model.entry,
        "C": model.rows,
        "D": model.through,
        "num": _cells([[own.numerator for own in row] for row in paths]),
        "den": _cells([[own.denominator for own in row] for row in paths]),
        "delays_s": model.delays,
        "input_names": _names(model.input_names),
        "output_names": _names(model.output_names),
        "input_unit": model.input_unit,
        "output_unit": model.output_unit,
        "structure": model.structure,
        "natural_frequencies_rad_s": np.array([mode.omega for mode in model.modes]),
        "natural_frequency_sd_rad_s": np.array([mode.omega_sd for mode in model.modes]),
        "damping_ratios": np.array([mode.zeta for mode in model.modes]),
        "damping_ratio_sd": np.array([mode.zeta_sd for mode in model.modes]),
        "parameter_names": _names(model.parameter_names),
        "parameters": model.parameters,
        "covariance": model.covariance,
        "noise_sd": np.concatenate([np.atleast_1d(getattr(own, "noise_sd", np.nan)) for own in model.models]),
        "source": model.source,
    }
    stream = io.BytesIO()
    savemat(stream, content, long_field_names=True, oned_as="column", do_compression=True)
    return stream.getvalue()


def _names(names: Sequence[str]) -> np.ndarray:
    """Return names as a cell array."""
    cells = np.empty((len(names), 1), dtype=object)
    for k, name in enumerate(names):
        cells[k, 0] = name
    return cells


def _cells(rows: Sequence[Sequence[FloatArray]]) -> np.ndarray:
    """Return polynomials as a cell array of rows."""
    cells = np.empty((len(rows), len(rows[0])), dtype=object)
    for j, row in enumerate(rows):
        for k, polynomial in enumerate(row):
            cells[j, k] = polynomial[None]
    return cells
