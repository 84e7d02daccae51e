"""A model for programs of modal analysis: mode shapes as data sets 55, frequency responses as data sets 58.

Outputs are the nodes 1, 2 .., inputs the nodes behind them, all along x. Data sets 55 have six digits, 58 twelve.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import ModalModel
from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import WriteRequest

_BEYOND = 1.3  # times the highest natural frequency: where the responses end
_LINES_A_BAND = 4.0  # of the narrowest half-power band
_MAX_LINES = 16_384
_SPEC_OF_UNIT = {"m": 8, "m/s": 11, "m/s2": 12, "N": 13}  # of data sets 55 and 58
_FREQUENCY = 18
_FRF = 4


def universal_file(request: WriteRequest) -> bytes:
    """Return the file.

    Raises
    ------
    UsageError
        pyuff is missing.
    """
    try:
        import pyuff
    except ImportError as err:
        raise UsageError(
            "universal files are written by pyuff; install this package with its `files` extra"
        ) from err
    model = request.model
    sets: list[dict[str, Any]] = [
        pyuff.prepare_164(
            units_code=1,
            units_description="SI",
            temp_mode=1,
            length=1.0,
            force=1.0,
            temp=1.0,
            temp_offset=273.15,
        )
    ]
    if len(model.models) == 1 and isinstance(model.models[0], ModalModel):
        sets += _shapes(pyuff, request)
    hertz = line_frequencies(request)
    response = model.response(2.0 * math.pi * hertz)
    for j, output in enumerate(model.output_names):
        for k, drive in enumerate(model.input_names):
            sets.append(
                pyuff.prepare_58(
                    func_type=_FRF,
                    id1=f"{output} / {drive}",
                    id2=model.source[:80],
                    rsp_ent_name=output[:10],
                    rsp_node=1 + j,
                    rsp_dir=1,
                    ref_ent_name=drive[:10],
                    ref_node=1 + len(model.output_names) + k,
                    ref_dir=1,
                    abscissa_spacing=1,
                    abscissa_spec_data_type=_FREQUENCY,
                    abscissa_axis_units_lab="Hz",
                    ordinate_spec_data_type=_SPEC_OF_UNIT.get(model.output_unit, 0),
                    ordinate_axis_units_lab=model.output_unit or "NONE",
                    orddenom_spec_data_type=_SPEC_OF_UNIT.get(model.input_unit, 0),
                    orddenom_axis_units_lab=model.input_unit or "NONE",
                    data=response[:, j, k],
                    x=hertz,
                )
            )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.uff"
        pyuff.UFF(str(path)).write_sets(sets, "overwrite")
        return path.read_bytes()


def line_frequencies(request: WriteRequest) -> FloatArray:
    """Return the lines of the responses [Hz], so close that the narrowest resonance is seen.

    Their spacing has two digits, for the format keeps six.
    """
    modes = request.model.modes
    if not modes:
        raise UsageError(
            "--uff: the model has no mode, and nothing says over which band to write its response"
        )
    highest = _BEYOND * modes[-1].omega / (2.0 * math.pi)
    narrowest = min(2.0 * abs(mode.zeta) * mode.omega for mode in modes) / (2.0 * math.pi)
    spacing = max(narrowest / _LINES_A_BAND, highest / _MAX_LINES)
    scale = 10.0 ** (math.floor(math.log10(spacing)) - 1)
    spacing = math.ceil(spacing / scale) * scale
    return np.asarray(spacing * np.arange(1, math.ceil(highest / spacing) + 1))


def _shapes(pyuff: Any, request: WriteRequest) -> list[dict[str, Any]]:
    """Return a data set 55 for every mode: residues of the first input, over the largest of them."""
    model = request.model
    own: ModalModel = model.models[0].paths[0]
    shapes, _ = own.mode_shapes()
    nothing = np.zeros(len(model.output_names))
    return [
        pyuff.prepare_55(
            id1=f"mode {number}",
            id2=", ".join(model.output_names)[:80],
            id3=model.source[:80],
            model_type=1,
            analysis_type=2,
            data_ch=2,
            spec_data_type=_SPEC_OF_UNIT["m"],
            data_type=2,
            n_data_per_node=3,
            r1=shape,
            r2=nothing,
            r3=nothing,
            load_case=1,
            mode_n=number,
            freq=float(omega) / (2.0 * math.pi),
            modal_m=1.0,
            modal_damp_vis=float(zeta),
            modal_damp_his=0.0,
            node_nums=list(range(1, len(shape) + 1)),
        )
        for number, (shape, omega, zeta) in enumerate(
            zip(shapes.T, own.natural_frequencies, own.damping_ratios, strict=True), 1
        )
    ]
