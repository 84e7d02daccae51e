"""A stored model in the one form that every format is written from: states, polynomials, modes, covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from beam_ident import EstimationError, ModalModel, MultiInputModel, SubspaceModel, TransferFunctionModel
from beam_ident.modal.structure import ModalStructure
from beam_ident.report.evidence import ModeRow, mode_rows
from beam_ros.arrays import ComplexArray, FloatArray
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import MOTIONS

_INPUT_UNITS = {"base_motion": "m", "velocity": "m/s", "acceleration": "m/s2"}
_OUTPUT_UNITS = {"mobility": "m/s", "accelerance": "m/s2"}


@dataclass(frozen=True, eq=False)
class TransferPath:
    """From one input to one output.

    Attributes
    ----------
    numerator, denominator : ndarray -- descending powers of s
    delay : float -- [s]
    """

    numerator: FloatArray
    denominator: FloatArray
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class ExportedModel:
    """A model as it leaves.

    Attributes
    ----------
    models : tuple -- as they were stored
    source : str -- where they come from: the file's name and its checksum
    structure : str -- of a modal model, with the input that it leaves with; else empty
    input_names, output_names : tuple of str
    input_unit, output_unit : str -- "m/s2"; empty where the model does not know
    transition, entry, rows, through : ndarray
        A (n, n), B (n, n_inputs), C (n_outputs, n), D (n_outputs, n_inputs) of ``x' = A x + B u, y = C x + D u``,
        without the delays.
    paths : tuple of tuple of TransferPath -- for every output one for each input
    """

    models: tuple[Any, ...]
    source: str
    structure: str
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    input_unit: str
    output_unit: str
    transition: FloatArray
    entry: FloatArray
    rows: FloatArray
    through: FloatArray
    paths: tuple[tuple[TransferPath, ...], ...] = field(default=())

    @cached_property
    def modes(self) -> list[ModeRow]:
        """Natural frequencies [rad/s] and damping ratios with their standard deviations, in order."""
        return sorted(mode_rows(self.models), key=lambda mode: mode.omega)

    @property
    def delays(self) -> FloatArray:
        """Delay of every path, shape (n_outputs, n_inputs) [s]; what is written as states has none."""
        return np.array([[own.delay for own in row] for row in self.paths])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names in the order of ``covariance``; of several outputs with the output's name behind."""
        several = len(self.models) > 1
        return tuple(
            f"{name}[{model.output_name}]" if several else name
            for model in self.models
            for name in getattr(model, "parameter_names", ())
        )

    @property
    def parameters(self) -> FloatArray:
        """Values in the order of ``covariance``."""
        return np.concatenate([getattr(model, "parameters", np.zeros(0)) for model in self.models])

    @property
    def covariance(self) -> FloatArray:
        """Of all parameters; those of one output are taken to know nothing of another's."""
        return np.asarray(
            block_diag(*(getattr(model, "covariance", np.zeros((0, 0))) for model in self.models))
        )

    def response(self, omegas: FloatArray) -> ComplexArray:
        """Return the frequency response, shape (n_frequencies, n_outputs, n_inputs), delays included."""
        s = 1j * omegas
        size = len(self.transition)
        found = np.empty((len(s), *self.through.shape), dtype=np.complex128)
        for k, own in enumerate(s):
            inner = np.linalg.solve(own * np.eye(size) - self.transition, self.entry)
            found[k] = (self.rows @ inner + self.through) * np.exp(-own * self.delays)
        return found


def exported_model(models: Sequence[Any], source: str, driven_by: str = "") -> ExportedModel:
    """Return stored models of one system in the form that is written.

    Parameters
    ----------
    models : sequence -- what ``model.json`` holds: one modal model, or transfer functions, one for each output
    source : str -- file and checksum
    driven_by : str
        Of a moved base: "acceleration", "velocity" or "base_motion"; empty: the acceleration, which no format has to
        differentiate.

    Raises
    ------
    UsageError
        No model of motion is among them, or one that differentiates its input.
    """
    try:
        if len(models) == 1 and isinstance(models[0], ModalModel):
            return _modal(models[0], source, driven_by)
        if driven_by:
            raise UsageError("--driven-by goes with a modal model alone; leave it out")
        return _of_paths(models, source)
    except EstimationError as err:
        raise UsageError(f"{source}: {err}") from err


def _modal(model: ModalModel, source: str, driven_by: str) -> ExportedModel:
    if ModalStructure(model.structure).is_motion:
        model = model.driven_by(driven_by or MOTIONS[0])  # type: ignore[arg-type]
    elif driven_by:
        raise UsageError(
            f"--driven-by {driven_by}: the model is driven by a force ({model.structure}), which has other poles; "
            "leave --driven-by out"
        )
    by_input = [path.polynomials() for path in model.paths]
    paths = tuple(
        tuple(TransferPath(numerators[j], denominator) for numerators, denominator in by_input)
        for j in range(len(model.output_names))
    )
    structure = model.structure
    return ExportedModel(
        (model,),
        source,
        structure,
        model.input_names,
        model.output_names,
        _INPUT_UNITS.get(structure, "N"),
        _OUTPUT_UNITS.get(structure, "m"),
        *model.state_space(),
        paths,
    )


def _of_paths(models: Sequence[Any], source: str) -> ExportedModel:
    """Put single transfer functions side by side, states and all."""
    by_output: dict[str, Any] = {}
    for model in models:
        if isinstance(model, TransferFunctionModel | MultiInputModel):
            by_output[model.output_name] = model
        elif isinstance(model, SubspaceModel):
            by_output |= {
                output: [
                    TransferFunctionModel(
                        numerator, model.denominator, 0.0, _unknown(numerator, model), 0.0, drive, output
                    )
                    for drive, numerator in zip(model.input_names, row, strict=True)
                ]
                for output, row in zip(model.output_names, model.numerators, strict=True)
            }
        else:
            raise UsageError(
                f"{source}: holds a {type(model).__name__}, not a model from input to output; expected a modal model "
                "or transfer functions, as `beam identify` writes them"
            )
    rows = {output: own if isinstance(own, list) else _paths_of(own) for output, own in by_output.items()}
    inputs = tuple(dict.fromkeys(path.input_name for row in rows.values() for path in row))
    parts = []
    for j, row in enumerate(rows.values()):
        for path in row:
            a, b, c, d = path.state_space()
            drive = np.zeros((1, len(inputs)))
            drive[0, inputs.index(path.input_name)] = 1.0
            seen = np.zeros((len(rows), 1))
            seen[j, 0] = 1.0
            parts.append((a, b @ drive, seen @ c, seen @ d @ drive))
    nothing = TransferPath(np.zeros(1), np.ones(1))
    return ExportedModel(
        tuple(models),
        source,
        "",
        inputs,
        tuple(rows),
        "",
        "",
        np.asarray(block_diag(*(part[0] for part in parts))),
        np.concatenate([part[1] for part in parts]),
        np.concatenate([part[2] for part in parts], axis=1),
        np.sum([part[3] for part in parts], axis=0),
        tuple(
            tuple(
                next(
                    (TransferPath(p.numerator, p.denominator, p.delay) for p in row if p.input_name == drive),
                    nothing,
                )
                for drive in inputs
            )
            for row in rows.values()
        ),
    )


def _paths_of(model: TransferFunctionModel | MultiInputModel) -> list[TransferFunctionModel]:
    return [model.path(name) for name in model.input_names] if isinstance(model, MultiInputModel) else [model]


def _unknown(numerator: FloatArray, model: SubspaceModel) -> FloatArray:
    """Return the covariance of a path about whose precision nothing is known."""
    size = len(numerator) + len(model.denominator)
    return np.zeros((size, size))


def checksummed_source(path: Path, digest: str) -> str:
    """Return how a file names where it comes from."""
    return f"{path.name} (SHA-256 {digest})"
