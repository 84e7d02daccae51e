"""Transfer functions from several inputs to one output, with their joint uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import require_input_signal, require_record
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.data.stored_form import checked_entries, complaints_about, names_of, plain
from beam_ident.errors import EstimationError, ModelFormatError
from beam_ident.summary import SummarisedModes, SummaryPart
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.output_prediction import OutputPrediction

SCHEMA = 1


@dataclass(frozen=True, eq=False, repr=False)
class MultiInputModel(SummarisedModes):
    """A continuous-time model from several inputs to one output.

    Attributes
    ----------
    numerators : tuple of ndarray -- of every input, descending powers of s
    denominators : tuple of ndarray -- one common to all inputs, or one for each; 1, a_1 .. a_n
    delays : tuple of float -- of every input [s]
    covariance : ndarray
        Of a_1 .. a_n of every denominator, then b_0 .. b_m of every input, then the delays; a
        parameter that was not estimated has variance 0.
    noise_sd : float -- of the residuals
    input_names : tuple of str
    output_name : str
    """

    numerators: tuple[FloatArray, ...]
    denominators: tuple[FloatArray, ...]
    delays: tuple[float, ...]
    covariance: FloatArray
    noise_sd: float
    input_names: tuple[str, ...]
    output_name: str = "y"

    def __post_init__(self) -> None:
        for name in ("numerators", "denominators"):
            polynomials = tuple(_read_only(values) for values in getattr(self, name))
            object.__setattr__(self, name, polynomials)
        object.__setattr__(self, "covariance", _read_only(self.covariance))
        n_inputs = len(self.input_names)
        if len(self.denominators) not in (1, n_inputs) or not (
            len(self.numerators) == len(self.delays) == n_inputs > 0
        ):
            raise ModelFormatError(
                f"multi-input model: {len(self.numerators)} numerators, {len(self.denominators)} denominators and "
                f"{len(self.delays)} delays for {n_inputs} inputs; expected one of each for every input, or one "
                "denominator for all"
            )
        if not all(
            len(values) and np.all(np.isfinite(values)) for values in (*self.numerators, *self.denominators)
        ):
            raise ModelFormatError(
                f"multi-input model: {list(self.numerators)} over {list(self.denominators)}; expected "
                "finite coefficients"
            )
        size = len(self.parameter_names)
        if self.covariance.shape != (size, size) or any(a[0] != 1.0 for a in self.denominators):
            raise ModelFormatError(
                f"multi-input model: covariance of shape {self.covariance.shape} and leading denominator "
                f"coefficients {[float(a[0]) for a in self.denominators]}; expected {(size, size)} and 1"
            )

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        paths = (self.path(name) for name in self.input_names)
        return [part for path in paths for part in path.summary_parts()]

    @property
    def pole_sets(self) -> tuple[TransferFunctionModel, ...]:
        """A path for every set of poles: one alone where all inputs share them."""
        return tuple(self.path(place) for place in range(len(self.denominators)))

    @property
    def has_common_poles(self) -> bool:
        """Whether one denominator serves all inputs."""
        return len(self.denominators) == 1

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names in the order of the covariance."""
        names = []
        for block, a in enumerate(self.denominators):
            of = "" if self.has_common_poles else f"[{self.input_names[block]}]"
            names += [f"a{i}{of}" for i in range(1, len(a))]
        for drive, b in zip(self.input_names, self.numerators, strict=True):
            names += [f"b{j}[{drive}]" for j in range(len(b))]
        return (*names, *(f"delay[{drive}]" for drive in self.input_names))

    @property
    def parameters(self) -> FloatArray:
        """Parameters in the order of the covariance."""
        return np.concatenate([*(a[1:] for a in self.denominators), *self.numerators, np.array(self.delays)])

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations in the order of the covariance."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def path(self, drive: int | str) -> TransferFunctionModel:
        """Return the transfer function of one input, by its place or its name, with its share of the covariance."""
        if isinstance(drive, str):
            if drive not in self.input_names:
                raise EstimationError(
                    f"no input {drive!r} in this model; available: {', '.join(self.input_names)}"
                )
            drive = self.input_names.index(drive)
        if not 0 <= drive < len(self.input_names):
            raise EstimationError(
                f"no input with number {drive}; expected 0 to {len(self.input_names) - 1}, or a name"
            )
        block = 0 if self.has_common_poles else drive
        lengths = [len(a) - 1 for a in self.denominators] + [len(b) for b in self.numerators]
        starts = np.concatenate([[0], np.cumsum(lengths)])
        n_blocks = len(self.denominators)
        index = np.concatenate(
            [
                np.arange(starts[block], starts[block + 1]),
                np.arange(starts[n_blocks + drive], starts[n_blocks + drive + 1]),
                [starts[-1] + drive],
            ]
        )
        return TransferFunctionModel(
            numerator=self.numerators[drive],
            denominator=self.denominators[block],
            delay=self.delays[drive],
            covariance=self.covariance[np.ix_(index, index)],
            noise_sd=self.noise_sd,
            input_name=self.input_names[drive],
            output_name=self.output_name,
        )

    def simulate(
        self, drives: Sequence[InputSignal], times_s: FloatArray, exposure_s: float = 0.0
    ) -> FloatArray:
        """Return the output that all inputs together cause from rest, shape (n_times,).

        Parameters
        ----------
        drives : sequence of InputSignal -- found by their names
        times_s : ndarray, shape (n_times,) -- inside the span of every input [s]
        exposure_s : float -- box average centred on each instant [s]
        """
        for drive in (drives,) if not isinstance(drives, Sequence) else drives:
            require_input_signal(drive)
        given = {drive.name: drive for drive in drives}
        missing = [name for name in self.input_names if name not in given]
        if missing:
            raise EstimationError(
                f"no input {', '.join(missing)} among {', '.join(given) or 'none'}; the model needs them all"
            )
        parts = [self.path(name).simulate(given[name], times_s, exposure_s) for name in self.input_names]
        return np.asarray(np.sum(parts, axis=0))

    def prediction(self, record: TimeRecord) -> OutputPrediction:
        """Return the output beside its prediction, with the record's own offset and initial state."""
        require_record(record)
        drives = [record.input(name) for name in self.input_names]

        def simulate(times: FloatArray, exposure_s: float) -> FloatArray:
            return self.simulate(drives, times, exposure_s)

        return OutputPrediction.of(record.output(self.output_name), drives, simulate, self.free_motions)

    def predict(self, record: TimeRecord) -> FloatArray:
        """Return what the model predicts at an output's stamps, NaN where an input is not known, (n_samples,)."""
        return self.prediction(record).everywhere()

    def free_motions(self, elapsed: FloatArray, exposure_s: float) -> FloatArray:
        """Return a constant, what integrators do on their own, and the free motions, as columns."""
        return np.concatenate([path.free_motions(elapsed, exposure_s) for path in self.pole_sets], axis=1)

    def frequency_response(self, omegas: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Return responses and standard deviations of their magnitudes, shape (n_frequencies, n_inputs).

        Parameters
        ----------
        omegas : ndarray, shape (n_frequencies,) -- [rad/s]
        """
        found = [self.path(name).frequency_response(omegas) for name in self.input_names]
        return np.stack([response for response, _ in found], axis=1), np.stack(
            [sd for _, sd in found], axis=1
        )

    def state_space(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return A, B (n, n_inputs), C (1, n), D (1, n_inputs); every input enters its own delay later.

        Notes
        -----
        Common poles have one set of states, in the observable form; other paths stand side by side.
        """
        parts = [self.path(name).state_space() for name in self.input_names]
        through = np.concatenate([direct for _, _, _, direct in parts], axis=1)
        if self.has_common_poles:
            transition, entry, _, _ = parts[0]
            return transition.T, np.concatenate([row.T for _, _, row, _ in parts], axis=1), entry.T, through
        rows = np.concatenate([row for _, _, row, _ in parts], axis=1)
        return (
            block_diag(*(part[0] for part in parts)),
            block_diag(*(part[1] for part in parts)),
            rows,
            through,
        )

    def to_scipy(self) -> Any:
        """Return a ``scipy.signal.StateSpace`` from all inputs; delays must be carried apart."""
        from scipy.signal import StateSpace

        if any(self.delays):
            raise EstimationError(
                f"scipy.signal has no delays and this model has {self.delays} s; use state_space() and delays, or "
                "simulate()"
            )
        return StateSpace(*self.state_space())

    def to_control(self, pade_order: int | None = None) -> Any:
        """Return a python-control ``TransferFunction`` with one column for each input.

        Parameters
        ----------
        pade_order : int or None -- of the approximation that stands for delays
        """
        paths = [self.path(name).to_control(pade_order) for name in self.input_names]
        import control

        numerators = [[path.num[0][0] for path in paths]]
        denominators = [[path.den[0][0] for path in paths]]
        return control.tf(numerators, denominators)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain lists and numbers, from which it is rebuilt exactly."""
        entries = {
            "schema": SCHEMA,
            "type": "multi_input_model",
            "numerators": self.numerators,
            "denominators": self.denominators,
            "delays_s": self.delays,
            "covariance": self.covariance,
            "noise_sd": self.noise_sd,
            "input_names": self.input_names,
            "output_name": self.output_name,
        }
        return {name: plain(value) for name, value in entries.items()}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> MultiInputModel:
        """Rebuild a model written by ``to_dict``.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or shapes that do not agree.
        """
        data = checked_entries(data, "multi_input_model", SCHEMA)
        with complaints_about("multi-input model"):
            return MultiInputModel(
                tuple(np.asarray(b, dtype=np.float64) for b in data["numerators"]),
                tuple(np.asarray(a, dtype=np.float64) for a in data["denominators"]),
                tuple(float(delay) for delay in data["delays_s"]),
                np.asarray(data["covariance"], dtype=np.float64),
                float(data["noise_sd"]),
                names_of(data["input_names"], "input_names"),
                str(data["output_name"]),
            )


def _read_only(values: Any) -> FloatArray:
    result = np.array(values, dtype=np.float64, copy=True)
    result.setflags(write=False)
    return result
