"""Time data: inputs and outputs that each keep their own clock.

An input is a sequence of samples with a *hold*, which says what it did in between;
an output is a sequence of samples at arbitrary stamps, each perhaps an average
over an exposure.  A record groups them on one time axis, in seconds relative to an
integer start in nanoseconds.  Nothing is resampled: the estimators take every
signal where it was really measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from beam_ident.arrays import AnyArray, FloatArray
from beam_ident.data.gaps import InputGap, bridged, on_every_stamp
from beam_ident.errors import RecordError
from beam_ident.numerics.piecewise import HOLDS, Hold, Instants, PiecewisePolynomial, regular_period
from beam_ident.summary import Summarised, SummaryPart, SummaryTable

_STEPS_A_LAG = 8.0  # of a low-pass: samples between which a spline is what it shows
_MOST_STEPS = 16  # between two samples of an input
TimesLike = Any  # an array of stamps [s], or the pair (start [s], period [s])


def _read_only(values: FloatArray) -> FloatArray:
    if values.dtype == np.float64 and values.flags.owndata and not values.flags.writeable:
        return values  # of another signal: long ones are not stored twice
    result = np.array(values, dtype=np.float64, copy=True)
    result.setflags(write=False)
    return result


def _numbers(name: str, what: str, values: Any) -> FloatArray:
    """Return real numbers as an array, NaN where they are masked, or raise RecordError."""
    try:
        if isinstance(values, np.ma.MaskedArray) and not np.iscomplexobj(values):
            values = np.ma.filled(values.astype(np.float64), np.nan)
        found = np.asarray(values)
        if not np.iscomplexobj(found) and found.dtype.kind not in "mM":
            return np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError) as err:
        raise RecordError(f"signal {name!r}: {what} are not numbers ({err}); expected real numbers") from err
    if found.dtype.kind in "mM":
        raise RecordError(
            f"signal {name!r}: {what} are dates ({found.dtype}), whose unit is lost as a number; expected seconds: "
            "(t - t[0]) / np.timedelta64(1, 's')"
        )
    raise RecordError(f"signal {name!r}: {what} are complex; expected real numbers")


def _is_number(value: Any) -> bool:
    """Whether a value is a finite real number."""
    is_real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return is_real and bool(np.isfinite(value))


def _stamps(name: str, times_s: TimesLike, n_values: int) -> FloatArray:
    """Return stamps as an array, or raise RecordError naming the first bad one."""
    if isinstance(times_s, tuple):
        if len(times_s) != 2 or not all(_is_number(t) for t in times_s) or not float(times_s[1]) > 0.0:
            raise RecordError(
                f"signal {name!r}: times_s is the tuple {times_s!r}; expected (start, period > 0) in seconds "
                "or an array of stamps"
            )
        return np.asarray(float(times_s[0]) + float(times_s[1]) * np.arange(n_values), dtype=np.float64)
    times = _numbers(name, "stamps", times_s)
    if times.ndim != 1 or len(times) != n_values:
        raise RecordError(
            f"signal {name!r}: {times.shape} stamps for {n_values} values; expected one stamp for each value"
        )
    if not np.all(np.isfinite(times)):
        first = int(np.flatnonzero(~np.isfinite(times))[0])
        raise RecordError(f"signal {name!r}: stamp {first} is {times[first]}; every stamp must be finite")
    steps = np.diff(times)
    if len(steps) and not np.all(steps > 0.0):
        first = int(np.flatnonzero(~(steps > 0.0))[0])
        raise RecordError(
            f"signal {name!r}: stamp {first + 1} ({times[first + 1]:.9f} s) does not come after stamp "
            f"{first} ({times[first]:.9f} s); sort the samples and drop repeated stamps"
        )
    return times


@dataclass(frozen=True)
class LowPass:
    """A low-pass that a sensor has of its own: what it shows is ``1 / (1 + lag s + bend s^2)`` of what is there.

    Attributes
    ----------
    lag_s : float -- how late it shows what changes slowly [s]
    bend_s2 : float -- 0 of a low-pass of first order [s^2]

    Raises
    ------
    RecordError
        Numbers that no sensor at rest has: a lag that is not above 0, a bend below 0.
    """

    lag_s: float
    bend_s2: float = 0.0

    def __post_init__(self) -> None:
        if not (
            _is_number(self.lag_s) and self.lag_s > 0.0 and _is_number(self.bend_s2) and self.bend_s2 >= 0.0
        ):
            raise RecordError(
                f"low-pass: lag_s is {self.lag_s!r} and bend_s2 {self.bend_s2!r}; expected a lag > 0 s and a bend "
                ">= 0 s^2, as LowPass.of_order(1, cutoff_hz) gives them"
            )

    @staticmethod
    def of_order(order: int, cutoff_hz: float) -> LowPass:
        """Return the Butterworth low-pass of order 1 or 2 that shows 71 % of what is there at a frequency [Hz]."""
        if order not in (1, 2) or not (_is_number(cutoff_hz) and cutoff_hz > 0.0):
            raise RecordError(
                f"low-pass: order is {order!r} and cutoff_hz {cutoff_hz!r}; expected an order of 1 or 2 and a "
                "frequency > 0 Hz"
            )
        time = 0.5 / (math.pi * cutoff_hz)
        return LowPass(time) if order == 1 else LowPass(math.sqrt(2.0) * time, time**2)

    @property
    def cutoff_hz(self) -> float:
        """Where it shows 71 % of what is there [Hz]."""
        # |1 + j lag w - bend w^2|^2 = 2
        half = 0.5 * (self.lag_s**2 - 2.0 * self.bend_s2)
        square = 1.0 / (half + math.hypot(half, self.bend_s2))
        return math.sqrt(square) / (2.0 * math.pi)

    def moved(self, lag_s: float, bend_s2: float) -> LowPass:
        """Return the low-pass with more lag [s] and bend [s^2], as far as there can be less of them."""
        return LowPass(max(self.lag_s + lag_s, 0.5 * self.lag_s), max(self.bend_s2 + bend_s2, 0.0))

    def of(self, drive: InputSignal) -> InputSignal:
        """Return what the sensor would show of an input, which was at rest where it begins.

        Notes
        -----
        A linear sensor behind a linear system shows what the system does of that.  It is a cubic spline through the
        input's samples, and through more where a held input has corners that the low-pass rounds.
        """
        from beam_ident.numerics.rational_response import (
            RationalResponse,
        )  # here: most records have no low-pass

        bottom = [self.bend_s2, self.lag_s, 1.0][int(self.bend_s2 == 0.0) :]
        roots = np.asarray(np.roots(bottom), dtype=np.complex128)
        scale = float(np.max(np.abs(roots)))
        times = drive.times_s
        if drive.hold in ("zoh", "linear"):  # whose corners it rounds
            steps = float(np.min(np.diff(times))) / self.lag_s * _STEPS_A_LAG
            finer = np.arange(0.0, 1.0, 1.0 / min(max(math.ceil(steps), 1), _MOST_STEPS))
            times = np.append((times[:-1, None] + np.diff(times)[:, None] * finer).ravel(), drive.span_s[1])
        rest = float(drive.values[0])
        signal = replace(drive, values=drive.values - rest).signal(from_rest=True)
        integral, instants = signal.antiderivative(), Instants.on(signal, times, 0.0)
        response = RationalResponse(
            roots[roots.imag >= 0.0] / scale, scale, signal, integral, instants, False
        )
        shown = response.over(0) * (scale ** (1 - len(bottom)) / bottom[0])
        hold: Hold = "band_limited" if drive.hold == "band_limited" else "cubic"
        return replace(drive, times_s=times, values=rest + shown, hold=hold)


@dataclass(frozen=True, eq=False)
class InputSignal:
    """What drove the system, with the hold that says what it did between samples.

    Parameters
    ----------
    name : str
    unit : str
    times_s : ndarray, shape (n,) or tuple (start, period) -- sample times [s]
        Where a grid lacks some, they are put in, but for a "zoh" or "linear" input that is zero on both sides.
    values : ndarray, shape (n,)
        NaN where a sample is missing, its stamp being known all the same; never at the ends.  Missing ones
        are filled in from both sides, see ``gaps``.
    hold : {"zoh", "linear", "cubic", "band_limited"}
        Constant until the next sample, straight lines, a cubic spline, or the signal without
        content above half the sampling rate that the samples determine (a spline of degree 9
        stands for it, see ``PiecewisePolynomial.from_samples``).
    sigma : float
        Standard deviation of the noise on each value; 0 for a known input.
    gaps : tuple of InputGap
        Where values were missing and are filled in, with the uncertainty of that.  Found from NaN and from holes in
        the stamps; given only for values that are filled in already.

    Raises
    ------
    RecordError
        Stamps that repeat or run backwards, fewer than two samples, infinite values, the first or the last
        missing, an unknown hold.
    """

    name: str
    unit: str
    times_s: FloatArray
    values: FloatArray
    hold: Hold = "zoh"
    sigma: float = 0.0
    gaps: tuple[InputGap, ...] = ()

    def __post_init__(self) -> None:
        values = _numbers(self.name, "values", self.values)
        if values.ndim != 1 or len(values) < 2:
            raise RecordError(
                f"input {self.name!r}: values have shape {values.shape}; expected at least two in a row"
            )
        if np.any(np.isinf(values)):
            first = int(np.flatnonzero(np.isinf(values))[0])
            raise RecordError(
                f"input {self.name!r}: value {first} is {values[first]}; mark a missing sample with NaN, never inf"
            )
        if self.hold not in HOLDS:
            raise RecordError(
                f"input {self.name!r}: hold is {self.hold!r}; expected one of {', '.join(HOLDS)}"
            )
        if not (_is_number(self.sigma) and self.sigma >= 0.0):
            raise RecordError(f"input {self.name!r}: sigma is {self.sigma!r}; expected a finite number >= 0")
        times = _stamps(self.name, self.times_s, len(values))
        if not self.gaps:
            times, values = on_every_stamp(times, values, self.hold in ("zoh", "linear"))
        if np.any(np.isnan(values)):
            values, gaps = bridged(self.name, times, values)
            object.__setattr__(self, "gaps", (*self.gaps, *gaps))
        object.__setattr__(self, "times_s", _read_only(times))
        object.__setattr__(self, "values", _read_only(values))

    @cached_property
    def period_s(self) -> float | None:
        """Sampling period [s] of a regular input, None for an irregular one."""
        return regular_period(self.times_s)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last instant [s] at which the input is known."""
        last = float(self.times_s[-1])
        if self.hold == "zoh":
            last += float(self.times_s[-1] - self.times_s[-2])
        return float(self.times_s[0]), last

    def signal(
        self, hold: Hold | None = None, margin_s: float = 0.0, from_rest: bool = False
    ) -> PiecewisePolynomial:
        """Return the input as a piecewise polynomial (see ``PiecewisePolynomial``)."""
        lead = "zero" if from_rest else "constant"
        return PiecewisePolynomial.from_samples(
            self.times_s,
            self.values,
            self.hold if hold is None else hold,
            margin_s,
            lead,  # type: ignore[arg-type]
            self.period_s,
        )

    def seen_through(self, low_pass: LowPass | None) -> InputSignal:
        """Return what a sensor with a low-pass would show of the input; itself where it has none."""
        return self if low_pass is None else low_pass.of(self)

    def between(self, start_s: float, end_s: float) -> InputSignal:
        """Return the part of the input that covers an interval [s]."""
        first = max(int(np.searchsorted(self.times_s, start_s, side="right")) - 1, 0)
        last = int(np.searchsorted(self.times_s, end_s, side="left")) + 1
        times = self.times_s[first:last]
        gaps = tuple(gap for gap in self.gaps if gap.end_s > times[0] and gap.start_s < times[-1])
        return replace(self, times_s=times, values=self.values[first:last], gaps=gaps)


@dataclass(frozen=True, eq=False)
class OutputSignal:
    """What was measured, at its own stamps.

    Parameters
    ----------
    name : str
    unit : str
    times_s : ndarray, shape (n,) or tuple (start, period) -- stamps [s]
    values : ndarray, shape (n,) -- NaN where nothing was seen
    exposure_s : float
        Every value is the mean over this long [s], centred on its stamp.
    sigma : float or None
        Standard deviation of the noise where it is known; only a starting value,
        because the estimators measure it from the residuals.
    low_pass : LowPass or None
        That of the sensor, where it is known.  ``identify`` takes it out, and finds one that is not stated; where it
        is not taken out it is refused.

    Raises
    ------
    RecordError
        Stamps that repeat or run backwards, infinite values, nothing but NaN.
    """

    name: str
    unit: str
    times_s: FloatArray
    values: FloatArray
    exposure_s: float = 0.0
    sigma: float | None = None
    low_pass: LowPass | None = None

    def __post_init__(self) -> None:
        values = _numbers(self.name, "values", self.values)
        if values.ndim != 1 or len(values) < 1:
            raise RecordError(
                f"output {self.name!r}: values have shape {values.shape}; expected one row of samples"
            )
        if np.any(np.isinf(values)):
            first = int(np.flatnonzero(np.isinf(values))[0])
            raise RecordError(
                f"output {self.name!r}: value {first} is {values[first]}; mark a missing sample with NaN, "
                "never inf"
            )
        if np.all(np.isnan(values)):
            raise RecordError(f"output {self.name!r}: all {len(values)} values are NaN; leave the output out")
        if not (_is_number(self.exposure_s) and self.exposure_s >= 0.0):
            raise RecordError(
                f"output {self.name!r}: exposure_s is {self.exposure_s!r}; expected a number >= 0"
            )
        if self.sigma is not None and not (_is_number(self.sigma) and self.sigma > 0.0):
            raise RecordError(
                f"output {self.name!r}: sigma is {self.sigma!r}; expected a number > 0, or None"
            )
        if not (self.low_pass is None or isinstance(self.low_pass, LowPass)):
            raise RecordError(
                f"output {self.name!r}: low_pass is {self.low_pass!r}; expected "
                "LowPass.of_order(1, cutoff_hz), or None"
            )
        object.__setattr__(self, "times_s", _read_only(_stamps(self.name, self.times_s, len(values))))
        object.__setattr__(self, "values", _read_only(values))

    @property
    def is_valid(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Which samples were seen, shape (n,)."""
        return np.asarray(np.isfinite(self.values))

    def is_within(self, first_s: float, last_s: float) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Return which samples lie in an interval [s] with all of their exposure, shape (n,)."""
        half = 0.5 * self.exposure_s
        return np.asarray((self.times_s - half >= first_s) & (self.times_s + half <= last_s))

    def overlaps(self, first_s: float, last_s: float) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Return which samples saw, with some of their exposure, an open interval [s], shape (n,)."""
        half = 0.5 * self.exposure_s
        return np.asarray((self.times_s + half > first_s) & (self.times_s - half < last_s))

    def between(self, start_s: float, end_s: float) -> OutputSignal:
        """Return the samples whose stamps lie in an interval [s]."""
        keep = (self.times_s >= start_s) & (self.times_s <= end_s)
        if not np.any(keep):
            raise RecordError(f"output {self.name!r}: no sample between {start_s} s and {end_s} s")
        return replace(self, times_s=self.times_s[keep], values=self.values[keep])


@dataclass(frozen=True, eq=False, repr=False)
class TimeRecord(Summarised):
    """One experiment: inputs and outputs on one time axis.

    Parameters
    ----------
    inputs : sequence of InputSignal
    outputs : sequence of OutputSignal
    start_ns : int
        Host time of the instant 0 s [ns].
    name : str

    Raises
    ------
    RecordError
        No input or no output, names used twice, or an output that the input's
        time span does not overlap.
    """

    inputs: tuple[InputSignal, ...]
    outputs: tuple[OutputSignal, ...]
    start_ns: int = 0
    name: str = field(default="record")

    def __post_init__(self) -> None:
        for what, kind in (("inputs", InputSignal), ("outputs", OutputSignal)):
            signals = _as_tuple(getattr(self, what))
            strangers = [type(signal).__name__ for signal in signals if not isinstance(signal, kind)]
            if strangers:
                raise RecordError(
                    f"record {self.name!r}: there is a {strangers[0]} among the {what}; expected {kind.__name__}s"
                )
            object.__setattr__(self, what, signals)
        if not self.inputs or not self.outputs:
            raise RecordError(
                f"record {self.name!r}: {len(self.inputs)} inputs and {len(self.outputs)} outputs; "
                "expected at least one of each"
            )
        names = [s.name for s in self.inputs] + [s.name for s in self.outputs]
        for name in names:
            if names.count(name) > 1:
                raise RecordError(
                    f"record {self.name!r}: the name {name!r} is used twice; give each signal its own"
                )
        for drive in self.inputs:
            first, last = drive.span_s
            for output in self.outputs:
                if output.times_s[0] > last or output.times_s[-1] < first:
                    raise RecordError(
                        f"record {self.name!r}: output {output.name!r} spans {output.times_s[0]:.3f} to "
                        f"{output.times_s[-1]:.3f} s and input {drive.name!r} {first:.3f} to {last:.3f} s: "
                        "they do not overlap. Check that both use the same clock"
                    )

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        rows = []
        for role, signal in [("input", own) for own in self.inputs] + [
            ("output", own) for own in self.outputs
        ]:
            times, values = signal.times_s, signal.values
            period = float(np.median(np.diff(times))) if len(times) > 1 else math.nan
            span = f"{times[0]:.6g} to {times[-1]:.6g}"
            size = f"{float(np.nanmin(values)):.4g} to {float(np.nanmax(values)):.4g}"
            rows.append((signal.name, role, signal.unit, str(len(values)), f"{1.0 / period:.6g}", span, size))
        return [
            f"{self.name}:",
            SummaryTable(
                ("signal", "role", "unit", "samples", "rate [Hz]", "time [s]", "values"), tuple(rows)
            ),
        ]

    @staticmethod
    def from_arrays(
        t: TimesLike,
        *,
        u: Any,
        y: Any,
        units: Mapping[str, str] | None = None,
        hold: Hold = "zoh",
        start_ns: int = 0,
        name: str = "record",
    ) -> TimeRecord:
        """Return a record of arrays that share their times.

        Parameters
        ----------
        t : ndarray, shape (n,), or tuple (start, period) -- stamps [s]
        u, y : ndarray, shape (n,) or (n, k), or mapping of names to ndarrays of shape (n,)
            Inputs and outputs.  Without names they are ``u`` and ``y``, or ``u1``, ``u2`` .. of several columns.
        units : mapping of str to str, optional
            By the signals' names.  A signal without one is taken for a displacement where a structure is chosen by
            units.
        hold : {"zoh", "linear", "cubic", "band_limited"} -- what the inputs do between samples
        start_ns : int -- host time of the instant 0 s [ns]
        name : str

        Raises
        ------
        RecordError
            Arrays of other lengths than ``t``, units of a name that there is not, and what ``InputSignal`` and
            ``OutputSignal`` refuse.
        """
        inputs, outputs = _named_columns("u", u), _named_columns("y", y)
        units = dict(units or {})
        strangers = sorted(set(units) - set(inputs) - set(outputs))
        if strangers:
            raise RecordError(
                f"record {name!r}: units name {strangers[0]!r}, not a signal; expected names among "
                f"{', '.join((*inputs, *outputs))}"
            )
        lengths = {key: np.shape(values)[:1] for key, values in (*inputs.items(), *outputs.items())}
        if len(set(lengths.values())) > 1:
            raise RecordError(
                f"record {name!r}: the signals have different lengths "
                f"({', '.join(f'{key} {n[0] if n else 1}' for key, n in lengths.items())}); expected one time "
                "for all. Make a TimeRecord of InputSignals and OutputSignals, which each have their own"
            )
        return TimeRecord(
            tuple(InputSignal(key, units.get(key, ""), t, values, hold) for key, values in inputs.items()),
            tuple(OutputSignal(key, units.get(key, ""), t, values) for key, values in outputs.items()),
            start_ns,
            name,
        )

    @staticmethod
    def from_dataframe(
        frame: Any,
        *,
        u: str | Sequence[str],
        y: str | Sequence[str],
        time: str | None = None,
        units: Mapping[str, str] | None = None,
        hold: Hold = "zoh",
        name: str = "record",
    ) -> TimeRecord:
        """Return a record of columns of a table: of pandas, polars, pyarrow, or anything else with named columns.

        Parameters
        ----------
        frame : table -- ``frame[name]`` is a column
        u, y : str or sequence of str -- columns that are inputs, and outputs
        time : str, optional
            Column of the stamps: seconds, or dates.  None: the table's index, as pandas has it.
        units, hold, name : as of ``from_arrays``

        Notes
        -----
        Dates become seconds after the first of them, which ``start_ns`` keeps as UNIX time.

        Raises
        ------
        RecordError
            A column that is not there, stamps that are no times, and what ``from_arrays`` refuses.
        """
        if time is None and not hasattr(frame, "index"):
            raise RecordError(
                f"record {name!r}: a {type(frame).__name__} has no index; expected the column of the stamps: "
                'time="t"'
            )
        stamps = np.asarray(frame.index) if time is None else _column(frame, time, name)
        start_ns = 0
        if stamps.dtype.kind == "M":
            dates = stamps.astype("datetime64[ns]").astype(np.int64)
            start_ns = int(dates[0]) if len(dates) else 0
            stamps = (dates - start_ns) * 1e-9
        elif stamps.dtype.kind == "m":
            stamps = stamps / np.timedelta64(1, "s")
        inputs, outputs = (
            {key: _column(frame, key, name) for key in ([given] if isinstance(given, str) else given)}
            for given in (u, y)
        )
        return TimeRecord.from_arrays(
            stamps, u=inputs, y=outputs, units=units, hold=hold, start_ns=start_ns, name=name
        )

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in order."""
        return tuple(output.name for output in self.outputs)

    def input(self, name: str) -> InputSignal:
        """Return an input by its name."""
        return _find(self.inputs, name, self.name)

    def output(self, name: str) -> OutputSignal:
        """Return an output by its name."""
        return _find(self.outputs, name, self.name)

    def between(self, start_s: float, end_s: float) -> TimeRecord:
        """Return a segment [s] of the record, for estimation or for validation."""
        return TimeRecord(
            tuple(drive.between(start_s, end_s) for drive in self.inputs),
            tuple(output.between(start_s, end_s) for output in self.outputs),
            self.start_ns,
            self.name,
        )

    def from_instant(self, start_ns: int) -> TimeRecord:
        """Return the record with its time counted from another instant [ns, UNIX]."""
        by_s = (self.start_ns - start_ns) * 1e-9
        if not by_s:
            return self

        def moved(drive: InputSignal) -> InputSignal:
            gaps = (replace(gap, start_s=gap.start_s + by_s, end_s=gap.end_s + by_s) for gap in drive.gaps)
            return replace(drive, times_s=drive.times_s + by_s, gaps=tuple(gaps))

        outputs = tuple(replace(own, times_s=own.times_s + by_s) for own in self.outputs)
        return TimeRecord(tuple(map(moved, self.inputs)), outputs, start_ns, self.name)

    def select(self, output_names: Sequence[str]) -> TimeRecord:
        """Return the record with some of its outputs only."""
        return TimeRecord(self.inputs, tuple(self.output(n) for n in output_names), self.start_ns, self.name)


_Signal = TypeVar("_Signal", InputSignal, OutputSignal)


def busiest_stretch(record: TimeRecord, most_samples: int = 100_000) -> TimeRecord:
    """Return a record, or of one with more samples of an output the stretch of so many where its input moves most.

    Parameters
    ----------
    record : TimeRecord
    most_samples : int
    """
    times = max((output.times_s for output in record.outputs), key=len)
    if len(times) <= most_samples:
        return record
    length = float(times[-1] - times[0]) * most_samples / len(times)
    pieces = []
    for begin in np.arange(float(times[0]), float(times[-1]) - 0.999 * length, length):
        inputs = tuple(drive.between(begin, begin + length) for drive in record.inputs)
        moved = sum(float(np.var(drive.values)) for drive in inputs)
        pieces.append((moved, begin, inputs))
    _, begin, inputs = max(pieces, key=lambda piece: piece[0])
    outputs = tuple(output.between(begin, begin + length) for output in record.outputs)
    return TimeRecord(inputs, outputs, record.start_ns, record.name)


def _named_columns(letter: str, given: Any) -> dict[str, Any]:
    """Return arrays by their names: of a mapping its own, else by a letter."""
    if isinstance(given, Mapping):
        return {str(key): values for key, values in given.items()}
    values = _numbers(letter, "values", given)
    if values.ndim == 1:
        return {letter: values}
    if values.ndim != 2:
        raise RecordError(
            f"{letter} has the shape {values.shape}; expected (n,) of one signal, or (n, k) of k signals"
        )
    return {f"{letter}{k}": column for k, column in enumerate(values.T, 1)}


def _column(frame: Any, column: str, record: str) -> AnyArray:
    """Return a column of a table as an array."""
    names = next(
        (
            found
            for word in ("column_names", "columns", "keys")
            if (found := getattr(frame, word, None)) is not None
        ),
        (),
    )
    names = list(names() if callable(names) else names)
    if column not in names:
        raise RecordError(
            f"record {record!r}: the table has no column {column!r}; expected one of {', '.join(map(str, names))}"
        )
    return np.asarray(frame[column])


def _as_tuple(signals: Any) -> tuple[Any, ...]:
    if isinstance(signals, InputSignal | OutputSignal):
        return (signals,)
    return tuple(signals) if isinstance(signals, Iterable) else (signals,)


def _find(signals: Iterable[_Signal], name: str, record: str) -> _Signal:
    available = []
    for signal in signals:
        if signal.name == name:
            return signal
        available.append(signal.name)
    raise RecordError(f"record {record!r} has no signal {name!r}; available: {', '.join(available)}")
