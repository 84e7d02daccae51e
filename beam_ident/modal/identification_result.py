"""What an identification says, in records or in lines: the model, its fit, and the table of orders."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.bandwidth import Band
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.stamp_jumps import ClockJump
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure
from beam_ident.noise.line_misfit import LineMisfit
from beam_ident.noise.record_fit import OverOutputs, RecordFit
from beam_ident.noise.scores import Scores, Whiteness
from beam_ident.summary import SummarisedModes, SummaryPart, modes_table, result_parts


@dataclass(frozen=True)
class OrderEntry:
    """One line of the order table.

    Attributes
    ----------
    n_modes, n_parameters : int
    bic, aic : float
    r_squared : float -- lowest R_T^2 over the outputs
    worst_fit_percent : float -- lowest FIT over the outputs
    condition : float -- of the scaled information matrix
    converged : bool
    refused_because : str -- empty when the order passed all gates
    is_chosen : bool
    weighed_by : str
        What the rows of this fit were weighed by; empty for equal weights. BIC and AIC, and scores, compare with
        those of entries that were weighed by the same.
    """

    n_modes: int
    n_parameters: int
    bic: float
    aic: float
    r_squared: float
    worst_fit_percent: float
    condition: float
    converged: bool
    refused_because: str
    is_chosen: bool = False
    weighed_by: str = ""


@dataclass(frozen=True, eq=False)
class OutputFit:
    """One output: what was measured and what the model says.

    Attributes
    ----------
    name, unit : str
    times_s, measured, modelled, residuals : ndarray, shape (n_used,)
        The samples that entered the fit, in the order of the records.
    deflection : ndarray, shape (n_used,)
        Measured less direct part, offset and ramp.
    noise_sd : float -- root of the mean square over all records
    scores : Scores -- on the output; with several records, each about its own mean
    deflection_scores : Scores -- on the deflection
    whiteness : Whiteness -- in units of each record's level
    offset, ramp : float
        Of the first record: at its middle, and over its whole length.
    records : tuple of RecordFit -- record by record, where the output is
    """

    name: str
    unit: str
    times_s: FloatArray
    measured: FloatArray
    modelled: FloatArray
    residuals: FloatArray
    deflection: FloatArray
    noise_sd: float
    scores: Scores
    deflection_scores: Scores
    whiteness: Whiteness
    offset: float
    ramp: float
    records: tuple[RecordFit, ...]


@dataclass(frozen=True)
class FrequencyChange:
    """How a natural frequency changed while it was recorded; the model has the one in between.

    Attributes
    ----------
    mode : int -- its number, from 0
    over : {"time", "swing"} -- evenly from the first stamp to the last, or with the square of the mode's amplitude
    from_hz, to_hz : float -- at the first stamp or at rest, and at the last stamp or at the largest amplitude
    share, share_sd : float -- the difference as a share of the model's, and its standard deviation
    swing : float -- the largest amplitude, at the output where it is largest and in its unit; 0 over time
    """

    mode: int
    over: Literal["time", "swing"]
    from_hz: float
    to_hz: float
    share: float
    share_sd: float
    swing: float = 0.0

    @property
    def sentence(self) -> str:
        """What must be known of it."""
        where = "from the first stamp to the last"
        remedy = "Record again once it is steady, or compare records"
        if self.over == "swing":
            where = f"from rest to a swing of {self.swing:.3g}"
            remedy = "Excite less for the frequency of small motion, or let amplitude_curves follow a decay"
        return (
            f"The natural frequency of mode {self.mode + 1} changed by {100.0 * self.share:+.3g} +- "
            f"{100.0 * self.share_sd:.1g} % {where}, {self.from_hz:.6g} to {self.to_hz:.6g} Hz: that was estimated "
            f"along, and the model has the one in between. {remedy}."
        )


@dataclass(frozen=True, eq=False, repr=False)
class IdentificationResult(SummarisedModes, OverOutputs):
    """A modal model and what is to be known about its estimation.

    Attributes
    ----------
    model : ModalModel
    structure : ModalStructure
    outputs : tuple of OutputFit
    orders : tuple of OrderEntry -- the order table; one line when the order was given
    band : Band -- where modes were looked for
    converged : bool
    reason : str -- why the iteration ended
    iterations : int
    warnings : tuple of str -- what a reader must know before trusting the numbers
    doubts : tuple of str -- of every mode why it cannot be trusted; empty where it can
    clock_jumps : tuple of ClockJump -- steps of the stamps' clocks; the stamps of the outputs are those without
    frequency_changes : tuple of FrequencyChange -- of modes whose frequencies are not steady
        Beside these, everything that ``OverOutputs`` lists.
    """

    model: ModalModel
    structure: ModalStructure
    outputs: tuple[OutputFit, ...]
    orders: tuple[OrderEntry, ...]
    band: Band
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    clock_jumps: tuple[ClockJump, ...] = ()
    frequency_changes: tuple[FrequencyChange, ...] = ()

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        model, *rest = result_parts(self, (self.model,), self.model.output_names)
        return [model, modes_table(*self.model.modes(), self.doubts), *rest[1:]]

    def output(self, name: str) -> OutputFit:
        """Return the fit of one output by its name."""
        for output in self.outputs:
            if output.name == name:
                return output
        raise EstimationError(
            f"no output {name!r} in this result; available: {', '.join(self.model.output_names)}"
        )

    def with_later_stamps(self, by_s: float) -> IdentificationResult:
        """Return what the same samples give under stamps that are later by a known time [s]."""
        model = replace(self.model, latency=self.model.latency + by_s * (1.0 + self.model.clock_rate))
        outputs = tuple(
            replace(
                output,
                times_s=output.times_s + by_s,
                records=tuple(replace(own, times_s=own.times_s + by_s) for own in output.records),
            )
            for output in self.outputs
        )
        jumps = tuple(replace(jump, at_s=jump.at_s + by_s) for jump in self.clock_jumps)
        return replace(self, model=model, outputs=outputs, clock_jumps=jumps)


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyDomainResult(SummarisedModes):
    """A modal model from frequency data.

    Attributes
    ----------
    model : ModalModel
    records : tuple of FrequencyRecord
    modelled : tuple of complex ndarray, each (n_lines, n_outputs, 1)
        What the model says at the lines, foldings included.
    orders : tuple of OrderEntry -- scores are those of the weighed lines
    misfit : LineMisfit
    converged, reason, iterations
        How the last fit ended.
    warnings : tuple of str
    """

    model: ModalModel
    records: tuple[FrequencyRecord, ...]
    modelled: tuple[ComplexArray, ...]
    orders: tuple[OrderEntry, ...]
    misfit: LineMisfit
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        return result_parts(self, (self.model,), self.model.output_names)

    @property
    def residuals(self) -> tuple[ComplexArray, ...]:
        """Responses less what the model says, each (n_lines, n_outputs, 1); NaN where none was measured."""
        return tuple(own.response - said for own, said in zip(self.records, self.modelled, strict=True))
