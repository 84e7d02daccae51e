"""Small models of every kind that is exported, and what a file of one is made from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beam_ident import ModalModel, MultiInputModel, TransferFunctionModel
from beam_ros.model_files.exported_model import exported_model
from beam_ros.model_files.formats import FORMATS, WriteRequest, make_file
from beam_ros.rig.rig import Rig

OMEGAS = 2.0 * np.pi * np.array([4.3, 27.9])
ZETAS = np.array([0.0053, 1 / 300])
GAINS = np.array([1.0, 0.75])
RESIDUES = np.array([[1.4, -0.5], [0.11, -1 / 3]])
STATIC = np.array([2e-6, -1e-6])
_ROOT = np.random.default_rng(1).standard_normal((14, 14))
COVARIANCE = 1e-8 * _ROOT @ _ROOT.T


def modal(structure: str = "base_motion", static: bool = True) -> ModalModel:
    """Two modes seen at two places."""
    return ModalModel(
        structure=structure,  # type: ignore[arg-type]
        input_name="hub",
        output_names=("z225", "tip"),
        natural_frequencies=OMEGAS,
        damping_ratios=ZETAS,
        residues=RESIDUES,
        residual_terms=STATIC * static,
        gains=GAINS * (structure != "receptance"),
        latency=0.003,
        clock_rate=1e-6,
        covariance=COVARIANCE,
        noise_sd=np.array([1e-5, 2e-5]),
    )


def transfer_functions(delay: float = 0.0) -> list[TransferFunctionModel]:
    """Two outputs with poles of their own."""
    return [
        TransferFunctionModel([3.0, 400.0], [1.0, 2.0, 900.0], delay, np.eye(5) * 1e-6, 1e-5, "u", "first"),
        TransferFunctionModel([7.0], [1.0, 30.0], delay, np.eye(3) * 1e-6, 1e-5, "u", "second"),
    ]


def two_inputs() -> MultiInputModel:
    """One output that two inputs move, with common poles."""
    return MultiInputModel(
        (np.array([2.0]), np.array([1.0, 5.0])),
        (np.array([1.0, 3.0, 400.0]),),
        (0.0, 0.0),
        np.eye(7) * 1e-8,
        1e-5,
        ("force", "wind"),
        "tip",
    )


def request_of(
    models: list[object], target: str = "model.bin", driven_by: str = "", **rig: object
) -> WriteRequest:
    """What a writer is given."""
    return WriteRequest(
        exported_model(models, "model.json (SHA-256 0123)", driven_by),
        Rig.from_file().with_values(rig),
        Path(target),
        Path("model.json"),
    )


def written(flag: str, request: WriteRequest) -> bytes:
    """Return the file of a format by its flag."""
    (own,) = (own for own in FORMATS if own.flag == flag)
    return make_file(own, request)
