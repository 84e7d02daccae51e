"""Frequency data: responses line by line, with what is known of their noise.

A record of frequency data holds the response of every output to every input at discrete
lines, made from time records by the estimators or measured elsewhere, and the
covariance of its noise.  A fit takes one or several of them.

A line that comes from sampled, held signals is not quite ``G(j omega)``.  A held input has
images at multiples of its sampling rate, and a sampled output folds every frequency onto
the lines below half its rate, so that

    H_l = G(j omega_l) + sum_m w_lm G(j omega_lm) + (what is left of G's first terms in 1/s)

``Folding`` carries the weights, which follow from the input and its hold alone; with them a
parametric fit is exact although the line is a mixture.  Without folding, a response is
taken for ``G(j omega)`` itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beam_ident.arrays import AnyArray, ComplexArray, FloatArray, IndexArray
from beam_ident.data.stored_form import ADDED_LATER, read, written
from beam_ident.errors import RecordError
from beam_ident.summary import Summarised, SummaryPart

SCHEMA = 2
TAIL_POWERS = (-2, -1, 0, 1, 2)

_REGULAR = 1e-6  # of the spacing of lines


def _fixed(values: Any, kind: Any) -> AnyArray:
    result = np.array(values, dtype=kind, copy=True)
    result.setflags(write=False)
    return result


@dataclass(frozen=True, eq=False)
class Folding:
    """What else a line of sampled, held signals carries, for one input.

    Attributes
    ----------
    omegas : ndarray, shape (n_lines, n_images)
        Frequencies of the images [rad/s]; negative where the line holds a conjugate.
    weights : complex ndarray, shape (n_lines, n_images)
        Their strength relative to the line's own.
    tails : complex ndarray, shape (n_lines, 5)
        Sum over all images left out of ``w (j omega)^-k`` for k = -2 .. 2: the model's
        expansion ``G = sum_k g_k s^-k`` at high frequency accounts for them.
    """

    omegas: FloatArray
    weights: ComplexArray
    tails: ComplexArray

    @property
    def strongest(self) -> FloatArray:
        """Weight of the strongest image of every line, shape (n_lines,)."""
        return np.asarray(np.max(np.abs(self.weights), axis=1, initial=0.0))

    def lines(self, keep: AnyArray) -> Folding:
        """Return the folding of some of the lines."""
        return Folding(self.omegas[keep], self.weights[keep], self.tails[keep])


@dataclass(frozen=True, eq=False)
class ResponseSeries:
    """One output's response to one input, for looking at.

    Attributes
    ----------
    omegas : ndarray, shape (n,) -- [rad/s]
    response : complex ndarray, shape (n,)
    sd : ndarray, shape (n,) -- of the complex value, both parts together; NaN where it is not known
    coherence : ndarray or None, shape (n,)
    method, input_name, output_name : str
    """

    omegas: FloatArray
    response: ComplexArray
    sd: FloatArray
    coherence: FloatArray | None
    method: str
    input_name: str
    output_name: str

    @property
    def frequencies_hz(self) -> FloatArray:
        """Frequencies of the lines [Hz]."""
        return np.asarray(self.omegas / (2.0 * np.pi))


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyRecord(Summarised):
    """Responses of every output to every input at discrete lines.

    Parameters
    ----------
    omegas : ndarray, shape (n_lines,) -- strictly increasing, positive [rad/s]
    response : complex ndarray, shape (n_lines,), (n_lines, n_outputs) or (n_lines, n_outputs, n_inputs)
        Kept in the last form.  NaN marks lines that were not measured.
    variance : ndarray of the response's shape, or None
        ``E |error|^2`` of every value, both parts together; None where it is not known.
    covariance : complex ndarray, shape (n_lines, n_pairs, n_pairs), or None
        ``E error error^H`` over all pairs of output and input, inputs varying quickest,
        where errors of several outputs depend on each other.
    output_names, input_names : sequence of str -- "y1", "y2" .. and "u1" .. when left out
    output_units, input_units : sequence of str
    coherence : ndarray of the response's shape, or None
    degrees_of_freedom : float -- behind every variance; infinite for a known one
    method : str -- how the response was made
    folding : Folding or None -- for one input
    name : str
    shared_lines : float
        Over how many neighbouring lines an error reaches, 1 where lines err independently.
    warnings : sequence of str -- what was found when it was made, for every fit to it to pass on
    decay_rate : float
        Of the exponential window ``e^(-decay_rate t)`` through which inputs and outputs were seen [1/s], 0 without
        one. A line is then the response at ``decay_rate + j omega``, and every fit takes it for that: the damping
        that the window adds is in no result.

    Raises
    ------
    RecordError
        Frequencies that do not increase, shapes that do not agree, negative variances.
    """

    omegas: FloatArray
    response: ComplexArray
    variance: FloatArray | None = None
    output_names: Sequence[str] = ()
    input_names: Sequence[str] = ()
    output_units: Sequence[str] = ()
    input_units: Sequence[str] = ()
    coherence: FloatArray | None = None
    covariance: ComplexArray | None = None
    degrees_of_freedom: float = np.inf
    method: str = "given"
    folding: Folding | None = None
    name: str = field(default="frequency record")
    shared_lines: float = 1.0
    warnings: Sequence[str] = ()
    decay_rate: float = field(default=0.0, metadata=ADDED_LATER)

    def __post_init__(self) -> None:
        omegas = self._numbers("omegas", np.float64)
        response = self._numbers("response", np.complex128)
        self._check(omegas, response)
        shape = response.shape + (1,) * (3 - response.ndim)
        object.__setattr__(self, "omegas", _fixed(omegas, np.float64))
        object.__setattr__(self, "response", _fixed(response.reshape(shape), np.complex128))
        self._complete_covariance(shape)
        for what in ("variance", "coherence"):
            if getattr(self, what) is not None:
                self._complete_row(what, shape)
        if self.folding is not None and (shape[2] != 1 or len(self.folding.omegas) != len(omegas)):
            self._refuse("folding needs one input and one row for every line")
        object.__setattr__(self, "warnings", tuple(self.warnings))
        self._complete_names(shape)

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        hertz = self.omegas / (2.0 * np.pi)
        return [
            f"{self.name}: {', '.join(self.input_names)} -> {', '.join(self.output_names)}",
            f"{len(hertz)} lines from {hertz[0]:.6g} to {hertz[-1]:.6g} Hz, {self.method}",
            *(f"warning: {said}" for said in self.warnings),
        ]

    def _check(self, omegas: AnyArray, response: AnyArray) -> None:
        """Refuse lines, a response and numbers that are none."""
        shape = response.shape
        if omegas.ndim != 1 or not len(omegas) or not np.all(np.isfinite(omegas)):
            self._refuse(f"omegas have shape {omegas.shape}; expected a row of finite frequencies")
        if not (omegas[0] > 0.0 and np.all(np.diff(omegas) > 0.0)):
            self._refuse("omegas must be positive and strictly increasing; sort the lines, leave out 0")
        if not 1 <= response.ndim <= 3 or shape[0] != len(omegas) or 0 in shape:
            self._refuse(
                f"the response has shape {shape} for {len(omegas)} lines; expected (n_lines, n_outputs, n_inputs)"
            )
        if np.any(np.isinf(response)):
            self._refuse("the response is infinite at some lines; mark a line that was not measured with NaN")
        if not self.degrees_of_freedom > 0.0:
            self._refuse(
                f"degrees_of_freedom is {self.degrees_of_freedom}; expected a number > 0, or infinity"
            )
        if not 1.0 <= self.shared_lines < np.inf:
            self._refuse(f"shared_lines is {self.shared_lines}; expected a number of at least 1")
        if not 0.0 <= self.decay_rate < np.inf or (self.decay_rate and self.folding is not None):
            self._refuse(
                f"decay_rate is {self.decay_rate}; expected a finite number of at least 0 [1/s], and 0 with folding"
            )

    def _complete_covariance(self, shape: tuple[int, ...]) -> None:
        """Take in the covariance, and the variance that it holds where none is given."""
        if self.covariance is None:
            return
        covariance, n_pairs = np.asarray(self.covariance, dtype=np.complex128), shape[1] * shape[2]
        if covariance.shape != (shape[0], n_pairs, n_pairs):
            self._refuse(f"covariance has shape {covariance.shape}; expected {(shape[0], n_pairs, n_pairs)}")
        object.__setattr__(self, "covariance", _fixed(covariance, np.complex128))
        if self.variance is None:
            diagonal = np.einsum("lpp->lp", covariance).real
            object.__setattr__(self, "variance", diagonal.reshape(shape))

    def _complete_row(self, what: str, shape: tuple[int, ...]) -> None:
        """Take in variance or coherence: one number for each of the response."""
        values = np.asarray(getattr(self, what), dtype=np.float64)
        if values.size != self.response.size:
            self._refuse(f"{what} has shape {values.shape}; expected {shape}, as the response")
        if np.any(values < 0.0):
            self._refuse(f"{what} is negative at {np.count_nonzero(values < 0.0)} lines; expected >= 0")
        measured = np.isfinite(self.response.ravel())
        if what == "variance" and not np.all(np.isfinite(values.ravel()[measured])):
            self._refuse("the variance is not finite where a response is; mark lines without one with NaN")
        object.__setattr__(self, what, _fixed(values.reshape(shape), np.float64))

    def _numbers(self, what: str, kind: type[np.generic]) -> AnyArray:
        try:
            return np.asarray(getattr(self, what), dtype=kind)
        except (TypeError, ValueError) as err:
            raise RecordError(f"frequency record {self.name!r}: {what} are not numbers ({err})") from err

    def _refuse(self, what: str) -> None:
        raise RecordError(f"frequency record {self.name!r}: {what}")

    def _complete_names(self, shape: tuple[int, ...]) -> None:
        for what, letter, count in (("output", "y", shape[1]), ("input", "u", shape[2])):
            names = tuple(getattr(self, f"{what}_names")) or tuple(f"{letter}{k + 1}" for k in range(count))
            units = tuple(getattr(self, f"{what}_units")) or ("",) * count
            if len(names) != count or len(units) != count or len(set(names)) != count:
                self._refuse(
                    f"{what}s are named {', '.join(names)} with units {units!r}; expected {count} different "
                    "names and as many units"
                )
            object.__setattr__(self, f"{what}_names", names)
            object.__setattr__(self, f"{what}_units", units)

    @property
    def n_lines(self) -> int:
        """Number of lines."""
        return len(self.omegas)

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return int(self.response.shape[1])

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return int(self.response.shape[2])

    @property
    def frequencies_hz(self) -> FloatArray:
        """Frequencies of the lines [Hz]."""
        return np.asarray(self.omegas / (2.0 * np.pi))

    @property
    def s(self) -> ComplexArray:
        """Complex frequencies of the lines [rad/s], beside the imaginary axis where a window was exponential."""
        return np.asarray(self.decay_rate + 1j * self.omegas, dtype=np.complex128)

    @property
    def line_correlation(self) -> ComplexArray | None:
        """Correlation of errors 0 .. n_lines - 1 lines apart, where an exponential window determines it; else None.

        Notes
        -----
        Noise behind the window e^(-a t) has the power e^(-2 a t), whose transform is the correlation of lines.  At
        the lines of a discrete transform it is ``2 a / (2 a + j m d)``, with m lines of spacing d between them.
        """
        if not self.decay_rate > 0.0 or self.n_lines < 2:
            return None
        apart = np.diff(self.omegas)
        if np.ptp(apart) > _REGULAR * apart[0]:
            return None
        twice = 2.0 * self.decay_rate
        return np.asarray(twice / (twice + 1j * (self.omegas - self.omegas[0])), dtype=np.complex128)

    @property
    def sd(self) -> FloatArray | None:
        """Standard deviation of every complex value, both parts together, or None."""
        return None if self.variance is None else np.asarray(np.sqrt(self.variance))

    @property
    def fit_warnings(self) -> tuple[str, ...]:
        """What a reader must know of a model that is fitted to these lines."""
        if self.shared_lines <= 1.0:
            return tuple(self.warnings)
        return (
            f"neighbouring lines share data ({self.method}): noise may look like modes; standard deviations count it "
            "as far as the residuals show it. Fit samples, or a response from periods",
            *self.warnings,
        )

    def series(self) -> tuple[ResponseSeries, ...]:
        """Return the response of every pair, outputs in order, inputs varying quickest."""
        found = []
        for j, output in enumerate(self.output_names):
            for i, drive in enumerate(self.input_names):
                sd = np.full(self.n_lines, np.nan) if self.sd is None else self.sd[:, j, i]
                coherence = None if self.coherence is None else self.coherence[:, j, i]
                values = self.response[:, j, i]
                found.append(ResponseSeries(self.omegas, values, sd, coherence, self.method, drive, output))
        return tuple(found)

    def between(self, low_hz: float, high_hz: float) -> FrequencyRecord:
        """Return the lines of a band [Hz]."""
        hertz = self.frequencies_hz
        keep = np.flatnonzero((hertz >= low_hz) & (hertz <= high_hz))
        if not len(keep):
            self._refuse(
                f"no line between {low_hz} and {high_hz} Hz; it has {hertz[0]:.4g} to {hertz[-1]:.4g} Hz"
            )
        return self._lines(keep)

    def measured(self) -> FrequencyRecord:
        """Return the lines that were measured at every pair of output and input."""
        seen = np.all(np.isfinite(self.response), axis=(1, 2))
        if not np.any(seen):
            self._refuse("no line was measured at every pair of output and input; select() pairs that were")
        return self if np.all(seen) else self._lines(np.flatnonzero(seen))

    def _lines(self, keep: IndexArray) -> FrequencyRecord:
        return self._changed(
            omegas=self.omegas[keep],
            response=self.response[keep],
            variance=None if self.variance is None else self.variance[keep],
            covariance=None if self.covariance is None else self.covariance[keep],
            coherence=None if self.coherence is None else self.coherence[keep],
            folding=None if self.folding is None else self.folding.lines(keep),
        )

    def select(
        self, output_names: Sequence[str] | None = None, input_names: Sequence[str] | None = None
    ) -> FrequencyRecord:
        """Return the record with some of its outputs and inputs only."""
        rows = self._places("output", self.output_names, output_names)
        columns = self._places("input", self.input_names, input_names)
        pick = np.ix_(np.arange(self.n_lines), rows, columns)
        pairs = (rows[:, None] * self.n_inputs + columns[None, :]).ravel()
        return self._changed(
            response=self.response[pick],
            variance=None if self.variance is None else self.variance[pick],
            coherence=None if self.coherence is None else self.coherence[pick],
            covariance=None if self.covariance is None else self.covariance[:, pairs[:, None], pairs],
            output_names=tuple(self.output_names[k] for k in rows),
            output_units=tuple(self.output_units[k] for k in rows),
            input_names=tuple(self.input_names[k] for k in columns),
            input_units=tuple(self.input_units[k] for k in columns),
        )

    def _places(self, what: str, available: Sequence[str], wanted: Sequence[str] | None) -> IndexArray:
        names = list(available)
        for name in wanted or ():
            if name not in names:
                self._refuse(f"no {what} {name!r}; available: {', '.join(names)}")
        return np.array([names.index(name) for name in (names if wanted is None else wanted)], dtype=np.intp)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "frequency_record", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> FrequencyRecord:
        """Rebuild what ``to_dict`` wrote.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or entries that do not agree.
        """
        return read(FrequencyRecord, data, "frequency_record", SCHEMA)

    def _changed(self, **changes: Any) -> FrequencyRecord:
        return FrequencyRecord(**{**vars(self), **changes})


def beside(records: Sequence[FrequencyRecord], name: str = "joined") -> FrequencyRecord:
    """Join records of the same outputs at the same lines, each with inputs of its own.

    Raises
    ------
    RecordError
        Other lines or outputs in one of them.
    """
    if not records:
        raise RecordError("no frequency record to join; give at least one")
    first = records[0]
    if len({record.decay_rate for record in records}) > 1:
        raise RecordError(
            "frequency records seen through different exponential windows cannot stand beside each other; make them "
            "with one decay_rate"
        )
    for record in records[1:]:
        if record.output_names != first.output_names or not np.array_equal(record.omegas, first.omegas):
            raise RecordError(
                f"frequency records {first.name!r} and {record.name!r} have different lines or outputs; only "
                "responses at the same lines can stand beside each other. Use between() and select() first"
            )
    variances = [record.variance for record in records]
    return FrequencyRecord(
        first.omegas,
        np.concatenate([record.response for record in records], axis=2),
        None if any(v is None for v in variances) else np.concatenate(variances, axis=2),  # type: ignore[arg-type]
        first.output_names,
        tuple(n for record in records for n in record.input_names),
        first.output_units,
        tuple(u for record in records for u in record.input_units),
        degrees_of_freedom=min(record.degrees_of_freedom for record in records),
        method=first.method,
        name=name,
        shared_lines=max(record.shared_lines for record in records),
        warnings=tuple(dict.fromkeys(said for record in records for said in record.warnings)),
        decay_rate=first.decay_rate,
    )
