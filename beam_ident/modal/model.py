"""The identified modal model: modal parameters with their joint uncertainty.

One object holds what every user of an identification needs: natural frequencies,
damping ratios, residues, residual terms and gains, with one covariance matrix over
all of them, so that every derived quantity (bands of a frequency response, a
comparison of two models, a physical fit) can carry its uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtrc as chi_squared_tail

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import finite_row, require_input_signal, require_time
from beam_ident.data.own_clocks import OwnClock
from beam_ident.data.records import InputSignal, LowPass
from beam_ident.data.stored_form import checked_entries, complaints_about, names_of, plain, require_shapes
from beam_ident.errors import EstimationError, ModelFormatError
from beam_ident.modal.frequency_response import ModalFrequencyResponse
from beam_ident.modal.mode_values import ModeValues
from beam_ident.modal.realisation import (
    modal_state_space,
    modal_step_response,
    n_integrations,
    transfer_polynomials,
)
from beam_ident.modal.regression import ClockState, forced_columns
from beam_ident.modal.structure import ModalStructure, StructureKind
from beam_ident.summary import SummarisedModes, SummaryPart, estimates_table, modes_table

SCHEMA = 1


@dataclass(frozen=True, eq=False, repr=False)
class ModalModel(SummarisedModes, ModeValues):
    """A sum of second-order modes with common poles over all outputs, and over all inputs where there are several.

    Attributes
    ----------
    structure : {"base_motion", "velocity", "acceleration", "force", "receptance", "mobility", "accelerance"}
        Where the modes stand (see ``modal.structure``).
    input_name : str -- the input, the first where there are several
    output_names : tuple of str
    natural_frequencies : ndarray, shape (n_modes,) -- [rad/s]
    damping_ratios : ndarray, shape (n_modes,)
    residues : ndarray, shape (n_outputs, n_modes)
        For a moved base pure numbers: the mode's share in -s^2 alpha.
    residual_terms : ndarray, shape (n_outputs,) -- static term R_j [s^2 for a moved base]
    gains : ndarray, shape (n_outputs,) -- direct gain c_j (0 for a receptance)
        With several inputs residues have the shape (n_outputs, n_inputs, n_modes), residual terms and gains
        (n_outputs, n_inputs).
    latency : float -- how late the outputs' stamps are [s]
    clock_rate : float -- how much faster the outputs' clock runs than the input's
    output_delays, output_delay_sd : ndarray, shape (n_outputs,)
        How much later than ``latency`` says the stamps of each output are, with its standard deviation [s]; 0 for
        outputs that share the clock.
    output_rates, output_rate_sd : ndarray, shape (n_outputs,)
        How much faster than ``clock_rate`` says the clock of each output runs, with its standard deviation.
    output_low_passes, output_low_pass_sd : ndarray, shape (n_outputs, 2)
        Lag [s] and bend [s^2] of the low-pass that was found at each output, with their standard deviations; 0 where
        there is none (see ``LowPass``).
    covariance : ndarray, shape (n_parameters, n_parameters)
    parameter_names : tuple of str
        ``omega_i``, ``zeta_i``, ``latency``, ``clock_rate``, then for every output j
        ``c[j]``, ``R[j]``, ``r_i[j]``; a parameter that was not estimated has variance 0.  With several inputs
        ``c[j, u]``, ``R[j, u]``, ``r_i[j, u]`` of one input u after the other.
    noise_sd : ndarray, shape (n_outputs,) -- of the residuals
    further_inputs : tuple of str -- where there are several, all but the first
    """

    structure: StructureKind
    input_name: str
    output_names: tuple[str, ...]
    natural_frequencies: FloatArray
    damping_ratios: FloatArray
    residues: FloatArray
    residual_terms: FloatArray
    gains: FloatArray
    latency: float
    clock_rate: float
    covariance: FloatArray
    noise_sd: FloatArray
    parameter_names: tuple[str, ...] = field(default=())
    output_delays: FloatArray = field(default_factory=lambda: np.empty(0))
    output_delay_sd: FloatArray = field(default_factory=lambda: np.empty(0))
    output_rates: FloatArray = field(default_factory=lambda: np.empty(0))
    output_rate_sd: FloatArray = field(default_factory=lambda: np.empty(0))
    output_low_passes: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    output_low_pass_sd: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    further_inputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        of_own_clocks = ("output_delays", "output_delay_sd", "output_rates", "output_rate_sd")
        of_low_passes = ("output_low_passes", "output_low_pass_sd")
        for name in (*of_own_clocks, *of_low_passes):
            if not len(getattr(self, name)):
                shape = (len(self.output_names), 2)[: 1 + (name in of_low_passes)]
                object.__setattr__(self, name, np.zeros(shape))
        for name in (
            *of_own_clocks,
            *of_low_passes,
            "natural_frequencies",
            "damping_ratios",
            "residues",
            "residual_terms",
            "gains",
            "covariance",
            "noise_sd",
        ):
            values = np.array(getattr(self, name), dtype=np.float64, copy=True)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        names = parameter_names(self.n_modes, self.output_names, self.input_names)
        object.__setattr__(self, "parameter_names", names)
        n, m = self.n_modes, len(self.output_names)
        paths = (m, len(self.input_names)) if self.further_inputs else (m,)
        shapes = {
            "damping_ratios": (n,),
            "residues": (*paths, n),
            "residual_terms": paths,
            "gains": paths,
            **dict.fromkeys(of_own_clocks, (m,)),
            **dict.fromkeys(of_low_passes, (m, 2)),
            "noise_sd": (m,),
            "covariance": (len(names), len(names)),
        }
        several = f", {len(self.input_names)} inputs" if self.further_inputs else ""
        require_shapes(f"modal model of {n} modes{several} and {m} outputs", self, shapes)
        self._require_parameters()

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        parts: list[SummaryPart] = [
            f"{', '.join(self.input_names)} -> {', '.join(self.output_names)} ({self.structure})",
            modes_table(*self.modes()),
        ]
        clock = {
            "latency [s]": (self.latency, self.latency_sd),
            "clock rate": (self.clock_rate, self.clock_rate_sd),
        }
        for name, delay, sd in zip(self.output_names, self.output_delays, self.output_delay_sd, strict=True):
            clock[f"{name} later [s]"] = float(delay), float(sd)
        known = {name: pair for name, pair in clock.items() if any(pair)}
        if known:
            parts.append(estimates_table(list(known), *np.array(list(known.values())).T))
        return parts

    def _require_parameters(self) -> None:
        """Raise ModelFormatError for an unknown structure, or for numbers that describe no modes."""
        try:
            ModalStructure(self.structure)
        except EstimationError as err:
            raise ModelFormatError(f"modal model: {err}") from err
        is_oscillation = (self.natural_frequencies > 0.0) & (np.abs(self.damping_ratios) < 1.0)
        if not (np.all(np.isfinite(self.parameters)) and np.all(is_oscillation)):
            raise ModelFormatError(
                f"modal model: natural frequencies {self.natural_frequencies} rad/s, damping ratios "
                f"{self.damping_ratios}; expected frequencies > 0, damping ratios below 1, and all parameters finite"
            )

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.natural_frequencies)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of all inputs."""
        return (self.input_name, *self.further_inputs)

    @property
    def paths(self) -> tuple[ModalModel, ...]:
        """The model from every input by itself; of one input the model as it is."""
        return tuple(self.path(name) for name in self.input_names)

    def path(self, input_name: str) -> ModalModel:
        """Return the model from one of the inputs alone, with its share of the covariance."""
        if input_name not in self.input_names:
            raise EstimationError(
                f"no input {input_name!r} in this model; available: {', '.join(self.input_names)}"
            )
        if not self.further_inputs:
            return self
        drive = self.input_names.index(input_name)
        n, width = 2 * self.n_modes + 2, self.n_modes + 2
        starts = n + width * (drive + len(self.input_names) * np.arange(len(self.output_names)))
        index = np.concatenate([np.arange(n), *(np.arange(first, first + width) for first in starts)])
        return replace(
            self,
            input_name=input_name,
            further_inputs=(),
            residues=self.residues[:, drive],
            residual_terms=self.residual_terms[:, drive],
            gains=self.gains[:, drive],
            covariance=self.covariance[np.ix_(index, index)],
        )

    def _require_one_input(self, what: str) -> None:
        if self.further_inputs:
            raise EstimationError(
                f"{what} goes with one input, and this model has {', '.join(self.input_names)}; take "
                f"path({self.input_name!r}) of it, or of another one"
            )

    def nothing_p_value(self) -> float:
        """Return how often outputs that do not follow the input would seem to follow it as much (Wald's test)."""
        return self._zero_p_value(np.arange(2 * self.n_modes + 2, len(self.parameters)))

    def no_body_p_value(self) -> float:
        """Return how often outputs without a rigid body would seem to follow one as much (Wald's test)."""
        return self._zero_p_value(
            np.arange(2 * self.n_modes + 2, len(self.parameters), self.n_modes + 2, dtype=np.intp)
        )

    def _zero_p_value(self, places: IndexArray) -> float:
        """Return how often parameters that are zero would seem to differ as much; 1 where none was estimated."""
        places = places[self.standard_deviations[places] > 0.0]
        if not len(places):
            return 1.0
        sds = self.standard_deviations[places]
        covariance = self.covariance[np.ix_(places, places)] / np.outer(sds, sds)
        scaled = self.parameters[places] / sds
        statistic = float(scaled @ np.linalg.lstsq(covariance, scaled, rcond=1e-12)[0])
        return float(chi_squared_tail(len(places), statistic))

    @property
    def has_body_under_force(self) -> bool:
        """Whether gains are those of a rigid body that a force moves."""
        structure = ModalStructure(self.structure)
        return structure.has_direct and not structure.is_motion

    @property
    def rigid_body_mass(self) -> FloatArray:
        """Mass that a force moves as a rigid body, as every output sees it: 1 / gain, in the gains' shape [kg].

        Infinite where nothing follows; EstimationError for a moved base and for a receptance.
        """
        if not self.has_body_under_force:
            raise EstimationError(
                f"the structure {self.structure!r} has no rigid body under a force; expected 'force', 'mobility' or "
                "'accelerance'. Identify with one of them from a measured force"
            )
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / self.gains)

    @property
    def rigid_body_mass_sd(self) -> FloatArray:
        """Standard deviations of ``rigid_body_mass`` [kg]."""
        return np.asarray(self.gain_sd * self.rigid_body_mass**2)

    @property
    def parameters(self) -> FloatArray:
        """All parameters in the order of ``parameter_names``."""
        parts = [self.natural_frequencies, self.damping_ratios, [self.latency, self.clock_rate]]
        terms = (self.gains.ravel(), self.residual_terms.ravel(), self._residues_by_path())
        for gain, residual, residues in zip(*terms, strict=True):
            parts.append(np.concatenate([[gain, residual], residues]))
        return np.concatenate([np.asarray(part, dtype=np.float64) for part in parts])

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations in the order of ``parameter_names``."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def _sd(self, first: int, count: int) -> FloatArray:
        return self.standard_deviations[first : first + count]

    @property
    def natural_frequency_sd(self) -> FloatArray:
        """Standard deviations of the natural frequencies [rad/s]."""
        return self._sd(0, self.n_modes)

    @property
    def damping_ratio_sd(self) -> FloatArray:
        """Standard deviations of the damping ratios."""
        return self._sd(self.n_modes, self.n_modes)

    @property
    def latency_sd(self) -> float:
        """Standard deviation of the latency [s]."""
        return float(self.standard_deviations[2 * self.n_modes])

    @property
    def clock_rate_sd(self) -> float:
        """Standard deviation of the clock rate."""
        return float(self.standard_deviations[2 * self.n_modes + 1])

    def _residues_by_path(self) -> FloatArray:
        return self.residues.reshape(self.gains.size, self.n_modes)

    def _output_sd(self) -> FloatArray:
        return self.standard_deviations[2 * self.n_modes + 2 :].reshape(*self.gains.shape, self.n_modes + 2)

    @property
    def gain_sd(self) -> FloatArray:
        """Standard deviations of the gains, in their shape."""
        return self._output_sd()[..., 0]

    @property
    def residual_term_sd(self) -> FloatArray:
        """Standard deviations of the residual terms, in their shape."""
        return self._output_sd()[..., 1]

    @property
    def residue_sd(self) -> FloatArray:
        """Standard deviations of the residues, in their shape."""
        return self._output_sd()[..., 2:]

    def simulate(
        self, drive: InputSignal | Sequence[InputSignal], times_s: FloatArray, exposure_s: float = 0.0
    ) -> FloatArray:
        """Return the outputs that an input, or all inputs together, cause from rest, shape (n_times, n_outputs).

        Parameters
        ----------
        drive : InputSignal or sequence of InputSignal
            Of the kind that the structure names; several are found by their names.
        times_s : ndarray, shape (n_times,) -- instants on the input's clock [s]
        exposure_s : float -- box average centred on each instant [s]
        """
        require_time("exposure_s", exposure_s)
        columns = forced_columns(
            self._drives(drive),
            ModalStructure(self.structure),
            finite_row("instants [s]", times_s),
            exposure_s,
            self.natural_frequencies,
            self.damping_ratios,
        )
        return np.asarray(columns @ self.column_parameters().T)

    def _drives(self, given: InputSignal | Sequence[InputSignal]) -> list[InputSignal]:
        """Return the signals of all inputs; of one input whatever its name."""
        drives = list(given) if isinstance(given, Sequence) else [given]
        for drive in drives:
            require_input_signal(drive)
        if len(drives) == len(self.input_names) == 1:
            return drives
        by_name = {drive.name: drive for drive in drives}
        missing = [name for name in self.input_names if name not in by_name]
        if missing:
            raise EstimationError(
                f"no input {', '.join(missing)} among {', '.join(by_name) or 'none'}; the model needs them all "
                "(path() takes one alone)"
            )
        return [by_name[name] for name in self.input_names]

    def column_parameters(self) -> FloatArray:
        """Return the parameters that ``modal.regression`` has columns for, in their order, a row for each output."""
        m, k = len(self.output_names), len(self.input_names)
        terms = [self.residual_terms.reshape(m, k, 1)]
        if ModalStructure(self.structure).has_direct:
            terms.insert(0, self.gains.reshape(m, k, 1))
        fixed = np.concatenate(terms, axis=2).reshape(m, -1)
        return np.concatenate([fixed, self.residues.reshape(m, -1)], axis=1)

    def frequency_response(self, omegas: FloatArray) -> ModalFrequencyResponse:
        """Return the response from input to outputs, with bands.

        Parameters
        ----------
        omegas : ndarray, shape (n_frequencies,) -- positive frequencies [rad/s]
        """
        self._require_one_input("a frequency response")
        omegas = finite_row("frequencies [rad/s]", omegas)
        structure = ModalStructure(self.structure)
        if n_integrations(structure) and not np.all(omegas):
            raise EstimationError(
                f"the response to {structure.kind} at 0 rad/s is infinite: a free base drifts away. Leave 0 out"
            )
        s = 1j * omegas
        front = structure.sign * s**structure.differentiations
        direct = np.array([structure.direct_response(value) for value in s], dtype=np.complex128)
        n, m = self.n_modes, len(self.output_names)
        omega_n, zeta = self.natural_frequencies, self.damping_ratios
        denominators = s[:, None] ** 2 + 2.0 * zeta * omega_n * s[:, None] + omega_n**2
        basis = front[:, None] / denominators
        by_omega = -basis / denominators * (2.0 * zeta * s[:, None] + 2.0 * omega_n)
        by_zeta = -basis / denominators * (2.0 * omega_n * s[:, None])
        response = np.empty((len(omegas), m), dtype=np.complex128)
        covariance = np.empty((len(omegas), m, 2, 2))
        for j in range(m):
            response[:, j] = (
                self.gains[j] * direct + front * self.residual_terms[j] + basis @ self.residues[j]
            )
            gradient = np.zeros((len(omegas), len(self.parameter_names)), dtype=np.complex128)
            gradient[:, :n] = by_omega * self.residues[j]
            gradient[:, n : 2 * n] = by_zeta * self.residues[j]
            place = 2 * n + 2 + j * (n + 2)
            gradient[:, place] = direct
            gradient[:, place + 1] = front
            gradient[:, place + 2 : place + 2 + n] = basis
            parts = np.stack([gradient.real, gradient.imag], axis=1)
            covariance[:, j] = np.einsum("fap,pq,fbq->fab", parts, self.covariance, parts, optimize=True)
        return ModalFrequencyResponse(omegas, self.output_names, response, covariance)

    def _own(self) -> tuple[ModalStructure, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        self._require_one_input("a form with one numerator for each output, or a response to a step,")
        return (
            ModalStructure(self.structure),
            self.natural_frequencies,
            self.damping_ratios,
            self.gains,
            self.residues,
            self.residual_terms,
        )

    def driven_by(self, structure: StructureKind) -> ModalModel:
        """Return the same model from another quantity of the base's motion.

        Raises
        ------
        EstimationError
            A force on either side: its poles are other poles.
        """
        if not (ModalStructure(self.structure).is_motion and ModalStructure(structure).is_motion):
            raise EstimationError(
                f"a {self.structure!r} model cannot be driven by {structure!r}; only 'base_motion', 'velocity' and "
                "'acceleration' describe the same system"
            )
        return replace(self, structure=structure)

    def polynomials(self) -> tuple[list[FloatArray], FloatArray]:
        """Return the numerator of every output and the common denominator, descending powers of s."""
        return transfer_polynomials(*self._own())

    def zpk(self, output: str) -> tuple[ComplexArray, ComplexArray, float]:
        """Return zeros [rad/s], poles [rad/s] and the gain of the highest power, for one output."""
        if output not in self.output_names:
            raise EstimationError(
                f"no output {output!r} in this model; available: {', '.join(self.output_names)}"
            )
        numerators, denominator = self.polynomials()
        numerator = numerators[self.output_names.index(output)]
        n_integrators = len(denominator) - 1 - 2 * self.n_modes
        poles = np.concatenate([self.poles, np.conj(self.poles), np.zeros(n_integrators)])
        return np.asarray(np.roots(numerator), dtype=np.complex128), poles, float(numerator[0])

    def state_space(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return A, B, C, D from the inputs to all outputs, with modal states, of each input its own.

        Raises
        ------
        EstimationError
            A residual term that differentiates the input; see ``driven_by``.
        """
        if not self.further_inputs:
            return modal_state_space(*self._own())
        parts = [path.state_space() for path in self.paths]
        transitions, entries, rows, through = zip(*parts, strict=True)
        return (
            np.asarray(block_diag(*transitions)),
            np.asarray(block_diag(*entries)),
            np.concatenate(rows, axis=1),
            np.concatenate(through, axis=1),
        )

    def step_response(self, times_s: FloatArray) -> FloatArray:
        """Return the response to a unit step of the input at 0 s, shape (n_times, n_outputs).

        Parameters
        ----------
        times_s : ndarray, shape (n_times,) -- after the step [s]
        """
        return modal_step_response(*self._own(), _after_the_step(times_s))

    def step_response_sd(self, times_s: FloatArray) -> FloatArray:
        """Return the standard deviation of ``step_response``, shape (n_times, n_outputs)."""
        self._require_one_input("a response to a step")
        times = _after_the_step(times_s)
        structure, n, m = ModalStructure(self.structure), self.n_modes, len(self.output_names)

        def response(parameters: FloatArray) -> FloatArray:
            own = parameters[2 * n + 2 :].reshape(m, n + 2)
            return modal_step_response(
                structure, parameters[:n], parameters[n : 2 * n], own[:, 0], own[:, 2:], own[:, 1], times
            )

        slopes = []
        for i, sd in enumerate(self.standard_deviations):
            step = np.zeros(len(self.parameters))
            step[i] = max(1e-3 * sd, 1e-6 * abs(self.parameters[i]))
            width = 2.0 * step[i] if sd > 0.0 else math.inf
            slopes.append((response(self.parameters + step) - response(self.parameters - step)) / width)
        gradient = np.stack(slopes)
        variance = np.einsum("ato,ab,bto->to", gradient, self.covariance, gradient, optimize=True)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def mode_shapes(self) -> tuple[FloatArray, FloatArray]:
        """Return mode shapes at the outputs and their standard deviations, each (n_outputs, n_modes).

        Notes
        -----
        Residues divided by each mode's largest one, which therefore is 1 without uncertainty.  With several inputs
        every input sees the same shapes, as far as they are those of modes of the structure: take those of the
        ``path`` that drives a mode best.
        """
        self._require_one_input("a mode shape")
        n, m = self.n_modes, len(self.output_names)
        shapes, sds = np.empty((m, n)), np.zeros((m, n))
        for i in range(n):
            index = 2 * n + 2 + np.arange(m) * (n + 2) + 2 + i
            covariance = self.covariance[np.ix_(index, index)]
            largest = int(np.argmax(np.abs(self.residues[:, i])))
            peak = self.residues[largest, i]
            shapes[:, i] = self.residues[:, i] / peak
            gradient = np.eye(m) / peak
            gradient[:, largest] -= shapes[:, i] / peak
            variance = np.einsum("ja,ab,jb->j", gradient, covariance, gradient)
            sds[:, i] = np.sqrt(np.maximum(variance, 0.0))
        return shapes, sds

    def to_scipy(self) -> Any:
        """Return a ``scipy.signal.StateSpace`` from the input to all outputs."""
        from scipy.signal import StateSpace

        return StateSpace(*self.state_space())

    def to_control(self) -> Any:
        """Return a python-control ``StateSpace`` with named signals (needs the package ``control``)."""
        try:
            import control
        except ImportError as err:
            raise EstimationError("python-control is not installed; `pip install control` brings it") from err
        return control.ss(*self.state_space(), inputs=list(self.input_names), outputs=list(self.output_names))

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain lists and numbers, from which it is rebuilt exactly."""
        entries = {
            "schema": SCHEMA,
            "type": "modal_model",
            "structure": self.structure,
            "input_name": self.input_name,
            "output_names": self.output_names,
            "natural_frequencies_rad_s": self.natural_frequencies,
            "damping_ratios": self.damping_ratios,
            "residues": self.residues,
            "residual_terms": self.residual_terms,
            "gains": self.gains,
            "latency_s": self.latency,
            "clock_rate": self.clock_rate,
            "output_delays_s": self.output_delays.tolist(),
            "output_delay_sd_s": self.output_delay_sd.tolist(),
            "output_rates": self.output_rates.tolist(),
            "output_rate_sd": self.output_rate_sd.tolist(),
            "noise_sd": self.noise_sd,
            "parameter_names": self.parameter_names,
            "covariance": self.covariance,
        }
        if self.low_passes:
            entries["output_low_passes"] = self.output_low_passes.tolist()
            entries["output_low_pass_sd"] = self.output_low_pass_sd.tolist()
        if self.further_inputs:  # a file of one input stays as earlier versions read it
            entries["further_inputs"] = self.further_inputs
        return {name: plain(value) for name, value in entries.items()}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> ModalModel:
        """Rebuild a model written by ``to_dict``.

        Raises
        ------
        ModelFormatError
            Another schema, a missing entry, or shapes that do not agree.
        """
        data = checked_entries(data, "modal_model", SCHEMA)
        with complaints_about("modal model"):
            further = names_of(data.get("further_inputs", []), "further_inputs")
            paths = (len(data["output_names"]), *([1 + len(further)] if further else []))
            return ModalModel(
                structure=ModalStructure(data["structure"]).kind,
                input_name=str(data["input_name"]),
                output_names=names_of(data["output_names"], "output_names"),
                natural_frequencies=np.asarray(data["natural_frequencies_rad_s"], dtype=np.float64),
                damping_ratios=np.asarray(data["damping_ratios"], dtype=np.float64),
                residues=np.asarray(data["residues"], dtype=np.float64).reshape(
                    *paths, len(data["natural_frequencies_rad_s"])
                ),
                residual_terms=np.asarray(data["residual_terms"], dtype=np.float64),
                gains=np.asarray(data["gains"], dtype=np.float64),
                latency=float(data["latency_s"]),
                clock_rate=float(data["clock_rate"]),
                # Files of earlier versions know none.
                output_delays=np.asarray(data.get("output_delays_s", []), dtype=np.float64),
                output_delay_sd=np.asarray(data.get("output_delay_sd_s", []), dtype=np.float64),
                output_rates=np.asarray(data.get("output_rates", []), dtype=np.float64),
                output_rate_sd=np.asarray(data.get("output_rate_sd", []), dtype=np.float64),
                output_low_passes=np.asarray(data.get("output_low_passes", []), dtype=np.float64),
                output_low_pass_sd=np.asarray(data.get("output_low_pass_sd", []), dtype=np.float64),
                covariance=np.asarray(data["covariance"], dtype=np.float64),
                noise_sd=np.asarray(data["noise_sd"], dtype=np.float64),
                further_inputs=further,
            )

    @property
    def own_clocks(self) -> dict[str, OwnClock]:
        """The clocks of outputs that have one of their own beside ``clock``, by name."""
        found = {}
        for name, delay, rate in zip(self.output_names, self.output_delays, self.output_rates, strict=True):
            if delay or rate:
                found[name] = OwnClock(float(delay), float(rate), bool(rate))
        return found

    @property
    def low_passes(self) -> dict[str, LowPass]:
        """The low-passes that were found at outputs, by name."""
        pairs = zip(self.output_names, self.output_low_passes.tolist(), strict=True)
        return {name: LowPass(*own) for name, own in pairs if own[0]}

    @property
    def clock(self) -> ClockState:
        """Latency and clock rate together."""
        return ClockState(self.latency, self.clock_rate)


def _after_the_step(times_s: FloatArray) -> FloatArray:
    """Return instants, or raise EstimationError for one before the step."""
    times = finite_row("instants [s]", times_s)
    if np.any(times < 0.0):
        raise EstimationError(
            f"an instant is {float(np.min(times))} s; the step is at 0 s: expected times from there on"
        )
    return times


def parameter_names(
    n_modes: int, output_names: tuple[str, ...], input_names: tuple[str, ...]
) -> tuple[str, ...]:
    """Name the parameters in the order of the covariance."""
    numbers = range(1, n_modes + 1)
    names = [f"omega_{i}" for i in numbers] + [f"zeta_{i}" for i in numbers] + ["latency", "clock_rate"]
    places = list(output_names)
    if len(input_names) > 1:
        places = [f"{output}, {drive}" for output in output_names for drive in input_names]
    for place in places:
        names += [f"c[{place}]", f"R[{place}]", *(f"r_{i}[{place}]" for i in numbers)]
    return tuple(names)
