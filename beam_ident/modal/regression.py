"""Columns of the modal model at the stamps where the outputs were measured.

Given poles and clock, every structure of ``modal.structure`` is linear in
the rest: gains, residues, offsets, ramps and free responses.  Several inputs share the poles, and each has gains,
residual terms and residues of its own.  This module builds
the columns of that linear problem and their exact derivatives with respect to
``log omega``, ``zeta`` and the instant of measurement.  Outputs that share stamps
share columns.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import chosen_inputs
from beam_ident.data.gaps import InputGap
from beam_ident.data.records import InputSignal, LowPass, OutputSignal, TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.modal.block_rows import BlockPart, BlockRows, ColumnBlock
from beam_ident.modal.mode_change import ModeChange, changes_of
from beam_ident.modal.restarts import RestartColumns, Restarts, restart_columns
from beam_ident.modal.structure import ModalStructure
from beam_ident.noise.input_noise import Smoothing
from beam_ident.numerics.free_motion import free_motions
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.pole_response import PoleResponses, SampledResponses

MAX_LATENCY_S = 0.2  # of a fit
_MARGIN = 1.25  # of the farthest latency: how far stamps and exposures may lie beyond the input's ends
_LATENCY_SHARE = 0.1  # of a record that is shorter than two seconds: no latency is looked for beyond

_MIN_SAMPLES = 20
_PIECE_ROWS = 8192  # what one piece needs stays in the cache
MAX_WHOLE = 2 * _PIECE_ROWS  # rows of a record that is not taken in pieces
_MAX_KEPT = 2_000_000  # numbers of the columns that wait for another look


@dataclass(frozen=True)
class ClockState:
    """Relation of the outputs' clock to the input's.

    A stamp ``t`` was taken at the instant ``m + (t - latency - m) / (1 + rate)`` of the
    input's clock, with ``m`` the middle of the record: a positive latency means that
    stamps are late, a positive rate that the outputs' clock runs fast.
    """

    latency: float = 0.0
    rate: float = 0.0


@dataclass(frozen=True, eq=False)
class _Grid:
    """Distinct stamps, exposure and low-pass of one record."""

    times: FloatArray
    exposure_s: float
    low_pass: LowPass | None


@dataclass(frozen=True, eq=False)
class _Seen:
    """What one input does at the instants of a grid."""

    instants: Instants
    direct: tuple[FloatArray, FloatArray]  # value, by time


@dataclass(frozen=True, eq=False)
class _Sampling:
    """Everything at one grid that depends on the clock alone."""

    clock: ClockState
    seen: list[_Seen]  # of every input
    fixed: list[tuple[FloatArray, FloatArray]]  # value, by time; of one input after the other
    elapsed: FloatArray  # since the first stamp that is used, on the input's clock
    latency_factor: FloatArray
    rate_factor: FloatArray


@dataclass(frozen=True, eq=False)
class _GridColumns:
    """All columns at one grid; derivatives by (log omega, zeta, time) where asked for."""

    sampling: _Sampling
    forced: tuple[FloatArray, ...]  # value[, by log omega, by zeta, by time], each (n_inputs * n_modes, n)
    free: tuple[ComplexArray, ...]
    ramp: FloatArray
    restarts: tuple[RestartColumns, ...]


def farthest_latency(drives: Sequence[InputSignal]) -> float:
    """Return how far the stamps may be moved against inputs that are measured together or one after the other [s]."""
    shortest = min(last - first for first, last in (drive.span_s for drive in drives))
    return min(MAX_LATENCY_S, _LATENCY_SHARE * shortest)


class _Driving:
    """What an input does, as exact signals that are made when they are asked for."""

    def __init__(self, drive: InputSignal, structure: ModalStructure) -> None:
        self._measured, self._structure = drive, structure
        self._margin_s = _MARGIN * farthest_latency([drive])
        self._is_position = structure.kind == "base_motion"
        self.rest = float(drive.values[0]) if self._is_position else 0.0
        self._responses: PoleResponses | None = None

    @cached_property
    def drive(self) -> PiecewisePolynomial:
        """The input, a position above where it begins."""
        signal = self._measured.signal(margin_s=self._margin_s, from_rest=not self._is_position)
        signal.coefficients[:, 0] -= self.rest  # made here, and as long as the record
        return signal

    @cached_property
    def position(self) -> PiecewisePolynomial:
        """The position that the input stands for, above ``rest``."""
        signal = self.drive
        for _ in range(0 if self._is_position else 2 - self._structure.differentiations):
            signal = signal.antiderivative()
        return signal

    @cached_property
    def residual(self) -> tuple[PiecewisePolynomial, int]:
        """What drives the residual term: a signal, and which of its derivatives."""
        structure = self._structure
        smooth = self.position
        if self._is_position or structure.is_test:
            smooth = self.drive
            if self._measured.hold == "linear":
                smooth = self._measured.signal("cubic", self._margin_s)
        if structure.is_motion or structure.kind == "accelerance":
            return smooth, 2
        return (smooth, 1) if structure.kind == "mobility" else (self.drive, 0)

    def responses(self, poles: ComplexArray, gradients: bool) -> PoleResponses:
        """Return the poles' responses at the knots of the input; the latest ones are kept."""
        known = self._responses
        if known is None or known.gradients < gradients or not np.array_equal(known.poles, poles):
            known = self._responses = PoleResponses(poles, self.drive, gradients)
        return known

    def release(self) -> None:
        """Let go of all signals."""
        self._responses = None
        for name in ("drive", "position", "residual"):
            self.__dict__.pop(name, None)


class _PreparedRecord:
    """One record, its inputs turned into exact signals."""

    def __init__(
        self,
        record: TimeRecord,
        drives: Sequence[InputSignal],
        structure: ModalStructure,
        restarts: tuple[tuple[InputGap, bool], ...] = (),
        n_drifts: int = 0,
        latency: float = 0.0,
    ) -> None:
        kind = structure.kind
        for drive in drives:
            if kind == "base_motion" and drive.hold == "zoh":
                raise EstimationError(
                    f"input {drive.name!r} is a position held ZOH, which would make the deflection jump; "
                    "give hold='linear', 'cubic' or 'band_limited'"
                )
        self.structure, self.restarts, self.n_drifts = structure, restarts, n_drifts
        spans = [drive.span_s for drive in drives]
        self.span = max(first for first, _ in spans), min(last for _, last in spans)
        # Of every low-pass, what its sensor sees of the inputs; in common with every choice of stamps.
        self.drivings = {
            own: [_Driving(drive.seen_through(own), structure) for drive in drives]
            for own in {output.low_pass for output in record.outputs}
        }
        self.grids: list[_Grid] = []
        self.grid_of: dict[str, int] = {}
        self.rows_of: dict[str, IndexArray] = {}
        keys: dict[tuple[bytes, float, LowPass | None], int] = {}
        for output in record.outputs:
            key = (output.times_s.tobytes(), output.exposure_s, output.low_pass)
            if key not in keys:
                keys[key] = len(self.grids)
                self.grids.append(_Grid(output.times_s, *key[1:]))
            self.grid_of[output.name] = keys[key]
            usable = output.is_within(*self.span) & output.is_valid
            for gap, _ in restarts:
                # Samples that the unknown part of the input touches.
                usable &= ~output.overlaps(gap.start_s + latency, gap.end_s + latency)
            self.rows_of[output.name] = np.flatnonzero(usable)
        stamps = np.concatenate([g.times for g in self.grids])
        # A camera may run for an hour before the input is known: nothing would be left of motion since then.
        used = [self.grids[self.grid_of[name]].times[rows] for name, rows in self.rows_of.items()]
        self.start = float(np.min(np.concatenate(used), initial=float(np.max(stamps))))
        self.middle = 0.5 * float(np.min(stamps) + np.max(stamps))
        self.length = max(float(np.max(stamps) - np.min(stamps)), 1e-12)
        self.values = {output.name: output.values for output in record.outputs}

        self._samplings: dict[int, _Sampling] | None = {}

    def with_stamps(self, rows: Sequence[slice | IndexArray]) -> _PreparedRecord:
        """Return the record with some stamps of every grid only; it keeps nothing that grows with their number."""
        result = copy.copy(self)
        result.grids = [
            replace(grid, times=grid.times[own]) for grid, own in zip(self.grids, rows, strict=True)
        ]
        result._samplings = None
        return result

    def with_structure(self, structure: ModalStructure) -> _PreparedRecord:
        """Return the record with a structure that differs in how modes change."""
        result = copy.copy(self)
        result.structure = structure
        return result

    def _sampling(self, number: int, clock: ClockState) -> _Sampling:
        known = None if self._samplings is None else self._samplings.get(number)
        if known is not None and known.clock == clock:
            return known
        grid, structure = self.grids[number], self.structure
        stretch = 1.0 / (1.0 + clock.rate)
        # (I.6), and its derivatives by latency and rate in the last two fields.
        late = grid.times - clock.latency - self.middle
        times = self.middle + late * stretch
        seen, fixed = [], []
        for driving in self.drivings[grid.low_pass]:
            instants = Instants.on(driving.drive, times, grid.exposure_s)
            above, speed = instants.mean(driving.position)
            seen.append(_Seen(instants, (above + driving.rest, speed)))
            if structure.has_direct:
                fixed.append(seen[-1].direct)
            if structure.has_residual:
                value, rate = instants.mean(*driving.residual)
                fixed.append((structure.sign * value, structure.sign * rate))
        known = _Sampling(
            clock,
            seen,
            fixed,
            times - self.start,
            np.full_like(times, -stretch),
            -late * stretch**2,
        )
        if self._samplings is not None:
            self._samplings[number] = known
        return known

    def instants(self, number: int, clock: ClockState) -> FloatArray:
        """Return when the samples at one grid of stamps were taken, on the input's clock [s]."""
        return np.asarray(self._sampling(number, clock).elapsed + self.start)

    def position_integrals_at(self, number: int, clock: ClockState) -> FloatArray:
        """Return the integral of the position that every input stands for, (n_stamps, n_inputs) [m s]."""
        drivings = self.drivings[self.grids[number].low_pass]
        integrals = [own.position.shifted(own.rest).antiderivative() for own in drivings]
        seen = self._sampling(number, clock).seen
        return np.stack([s.instants.mean(i)[0] for s, i in zip(seen, integrals, strict=True)], axis=1)

    def columns(
        self,
        number: int,
        omegas: FloatArray,
        zetas: FloatArray,
        clock: ClockState,
        gradients: bool,
        with_restarts: bool = True,
    ) -> _GridColumns:
        """Return every column at one grid of stamps."""
        structure, grid = self.structure, self.grids[number]
        sampling = self._sampling(number, clock)
        changes = changes_of(structure.changes, omegas)
        if changes:
            zetas = zetas.copy()
            for mode, own in changes.items():
                zetas[mode] = own.damping_ratio(float(omegas[mode]), float(zetas[mode]))
        poles = modal_poles(omegas, zetas)
        by_input = [
            self._forced(driving, seen, omegas, zetas, gradients, changes)
            for driving, seen in zip(self.drivings[grid.low_pass], sampling.seen, strict=True)
        ]
        forced = by_input[0]
        if len(by_input) > 1:
            forced = tuple(np.concatenate(own) for own in zip(*by_input, strict=True))
        column = poles[:, None]
        by_log_omega, by_zeta = pole_slopes(omegas, zetas)
        free: tuple[ComplexArray, ...] = ()
        if structure.has_free_response:
            elapsed, paces = sampling.elapsed, None
            if changes:
                elapsed, paces = self._in_own_times(elapsed, len(omegas), changes)
            free = free_motions(
                column, elapsed, grid.exposure_s, (by_log_omega, by_zeta) if gradients else ()
            )
            if paces is not None and gradients:
                free = (*free[:-1], free[-1] * paces)
        instants = self.instants(number, clock) if self.restarts else sampling.elapsed
        restarts = tuple(
            restart_columns(
                self.n_drifts,
                column if is_modal else column[:0],
                instants,
                grid.exposure_s,
                gap,
                tuple(own if is_modal else own[:0] for own in (by_log_omega, by_zeta)) if gradients else (),
            )
            for gap, is_modal in (self.restarts if with_restarts else ())
        )
        return _GridColumns(sampling, forced, free, (grid.times - self.middle) / self.length, restarts)

    def _in_own_times(
        self, elapsed: FloatArray, n_modes: int, changes: Mapping[int, ModeChange]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the time that has elapsed for every mode, and how fast it does, each (n_modes, n)."""
        found, paces = np.tile(elapsed, (n_modes, 1)), np.ones((n_modes, len(elapsed)))
        for mode, own in changes.items():
            instants = elapsed + self.start
            found[mode] = own.own_time(instants) - own.own_time(np.array([self.start]))
            paces[mode] = own.pace(instants)
        return found, paces

    def _change(
        self,
        sampled: SampledResponses,
        changes: Mapping[int, ModeChange],
        driving: _Driving,
        seen: _Seen,
        poles: ComplexArray,
    ) -> None:
        """Put in the responses of modes that change, which are those of a mode that does not in its own time."""
        before, after = self.structure.pace_powers
        for mode, own in changes.items():
            drive = own.signal(driving.drive, before)
            instants = Instants.on(drive, own.own_time(seen.instants.times), seen.instants.exposure_s)
            gradients = sampled.pole_slopes is not None
            responses = PoleResponses(poles[mode : mode + 1], drive, gradients)
            changed = responses.sample(instants, gradients)
            pace = own.pace(seen.instants.times)
            factor = pace**after
            sampled.values[mode] = factor * changed.values[0]
            if sampled.pole_slopes is not None and sampled.time_slopes is not None:
                assert changed.pole_slopes is not None
                assert changed.time_slopes is not None
                sampled.pole_slopes[mode] = factor * changed.pole_slopes[0]
                sampled.time_slopes[mode] = factor * pace * changed.time_slopes[0]

    def _forced(
        self,
        driving: _Driving,
        seen: _Seen,
        omegas: FloatArray,
        zetas: FloatArray,
        gradients: bool,
        changes: Mapping[int, ModeChange],
    ) -> tuple[FloatArray, ...]:
        """Return the columns of all modes under one input, and their derivatives by (log omega, zeta, time)."""
        structure, poles = self.structure, modal_poles(omegas, zetas)
        sampled = driving.responses(poles, gradients).sample(seen.instants, gradients)
        if changes:
            self._change(sampled, changes, driving, seen, poles)
        power, column = structure.differentiations, poles[:, None]
        # (I.5): one real column for every mode, Im(factor x).
        factor = column**power * structure.sign / column.imag
        values = _imaginary(factor, sampled.values)
        forced: tuple[FloatArray, ...] = (values,)
        if sampled.pole_slopes is not None and sampled.time_slopes is not None:
            slopes = sampled.pole_slopes
            if power:
                # d(p^k x)/dp = p^k (dx/dp + k x / p); below, Im(p) in the denominator of (I.5) moves as well.
                slopes = slopes + power / column * sampled.values
            by_pole = [
                _imaginary(factor * d, slopes) - values * (d.imag / column.imag)
                for d in pole_slopes(omegas, zetas)
            ]
            by_time = _imaginary(factor, sampled.time_slopes)
            if power == 2:
                by_time += structure.sign * seen.direct[1]
            forced = (values, *by_pole, by_time)
        if power == 2:
            # The direct term of (I.5), k = 2.
            values += structure.sign * (seen.direct[0] - driving.rest)
        return forced


def _imaginary(factors: ComplexArray, values: ComplexArray) -> FloatArray:
    """Return the imaginary parts of factors (n_poles, 1) times values (n_poles, n)."""
    result = factors.imag * values.real
    result += factors.real * values.imag
    return np.asarray(result)


def modal_poles(omegas: FloatArray, zetas: FloatArray) -> ComplexArray:
    """Return the upper pole of every mode [rad/s]."""
    return np.asarray(omegas * (-zetas + 1j * np.sqrt(1.0 - zetas**2)), dtype=np.complex128)


def pole_slopes(omegas: FloatArray, zetas: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the derivatives of the upper poles by ``log omega`` and ``zeta``, each (n_modes, 1)."""
    # dp/d log omega = p, dp/dzeta = omega (-1 - j zeta / sqrt(1 - zeta^2)).
    by_zeta = omegas * (-1.0 - 1j * (zetas / np.sqrt(1.0 - zetas**2)))
    return modal_poles(omegas, zetas)[:, None], by_zeta[:, None]


class ModalRegression:
    """The modal model of a set of records as a linear problem with a few nonlinear parameters.

    Parameters
    ----------
    records : sequence of TimeRecord
        Experiments that share poles, gains and residues.
    structure : ModalStructure
    input_name : str, sequence of str or None
        Which input, or inputs; None takes all.

    smoothing : Smoothing or None
        Low-pass that a noisy input passes first.
    restarts : Restarts or None
        The gaps of the inputs after which the modes begin anew; None: where the bridge is poor.

    Raises
    ------
    EstimationError
        No such input, a held position, too few usable samples.
    """

    is_noise_known = False
    is_sequence = True

    def __init__(
        self,
        records: Sequence[TimeRecord],
        structure: ModalStructure,
        input_name: str | Sequence[str] | None = None,
        smoothing: Smoothing | None = None,
        restarts: Restarts | None = None,
    ) -> None:
        if not records:
            raise EstimationError("no record to identify from; give at least one TimeRecord")
        self.structure = structure
        self.inputs = [chosen_inputs(record, input_name) for record in records]  # of every record
        self.max_latency_s = farthest_latency([drive for drives in self.inputs for drive in drives])
        self.margin_s = _MARGIN * self.max_latency_s
        self.input_names = tuple(drive.name for drive in self.inputs[0])
        smooth = [[d if smoothing is None else smoothing.of(d) for d in drives] for drives in self.inputs]
        self.restarts = Restarts.at_poor_bridges(self.inputs, structure) if restarts is None else restarts
        self._prepared = [
            _PreparedRecord(
                r, d, structure, self.restarts.of_record(k), self.restarts.n_drifts, self.restarts.latency
            )
            for k, (r, d) in enumerate(zip(records, smooth, strict=True))
        ]
        names = list(dict.fromkeys(name for record in records for name in record.output_names))
        self.units: list[str] = [
            next(o.unit for record in records for o in record.outputs if o.name == name) for name in names
        ]
        self.output_names: tuple[str, ...] = tuple(names)
        self.values: list[FloatArray] = []
        self.times: list[FloatArray] = []
        # Of every output: record, grid of stamps, rows of it, and the level by which they are divided.
        self._parts: list[tuple[tuple[int, int, bytes, float], ...]] = []
        self._rows: dict[tuple[int, int, bytes], IndexArray] = {}
        self.segments: list[list[tuple[int, slice]]] = []  # of every output: record and its rows
        for name in names:
            parts, values, times = [], [], []
            segments, n_rows = [], 0
            for index, prepared in enumerate(self._prepared):
                if name not in prepared.rows_of:
                    continue
                rows = prepared.rows_of[name]
                key = (index, prepared.grid_of[name], rows.tobytes())
                self._rows[key] = rows
                parts.append((*key, 1.0))
                segments.append((index, slice(n_rows, n_rows + len(rows))))
                n_rows += len(rows)
                values.append(prepared.values[name][rows])
                times.append(prepared.grids[prepared.grid_of[name]].times[rows])
            self._parts.append(tuple(parts))
            self.segments.append(segments)
            self.values.append(np.concatenate(values))
            self.times.append(np.concatenate(times))
            if len(self.values[-1]) < _MIN_SAMPLES:
                raise EstimationError(
                    f"output {name!r} has {len(self.values[-1])} samples that were seen while the input was "
                    f"known; expected at least {_MIN_SAMPLES}. Record longer, or leave this output out"
                )
        self.own_columns: dict[int, FloatArray] = {}
        self._latest: tuple[tuple[bytes, bytes, ClockState], list[ColumnBlock]] | None = None
        self.turns: tuple[Callable[[FloatArray], FloatArray], ...] = ()  # of every output's rows
        self.unturned = self
        # A piece of a long regression knows its record, and where the rows of every output stand in the whole.
        self.record: int | None = None
        self.places = [slice(0, len(values)) for values in self.values]
        self._find_blocks()

    def _find_blocks(self) -> None:
        is_own = [bool(self.turns) or j in self.own_columns for j in range(len(self._parts))]
        keys = [(parts, j if is_own[j] else -1) for j, parts in enumerate(self._parts)]
        self._block_keys = list(dict.fromkeys(keys))
        self.block_of: tuple[int, ...] = tuple(self._block_keys.index(key) for key in keys)

    def with_own_columns(self, columns: Mapping[int, FloatArray]) -> ModalRegression:
        """Return the regression with more linear parameters at some outputs.

        Parameters
        ----------
        columns : mapping -- from the number of an output to columns of its own, shape (n_rows, n), unweighed
        """
        if not columns and not self.own_columns:
            return self
        result = self._like()
        result.own_columns = dict(columns)
        result._find_blocks()
        return result

    @property
    def stamps_span_s(self) -> tuple[float, float]:
        """First and last stamp of the first record [s]."""
        first = self._prepared[0]
        return first.middle - 0.5 * first.length, first.middle + 0.5 * first.length

    def with_changes(self, changes: tuple[ModeChange, ...]) -> ModalRegression:
        """Return the regression with modes whose frequencies change so over a record."""
        result = self._like()
        result.structure = replace(self.structure, changes=changes)
        result._prepared = [own.with_structure(result.structure) for own in self._prepared]
        return result

    def weighed(self, levels: Sequence[FloatArray]) -> ModalRegression:
        """Return the regression whose rows and values are divided by the level of the noise in their record.

        Parameters
        ----------
        levels : sequence of ndarray -- of every output, one number for each of its ``segments``
        """
        result = self._like()
        result._parts = [
            tuple((*part[:3], float(level)) for part, level in zip(parts, own, strict=True))
            for parts, own in zip(self._parts, levels, strict=True)
        ]
        result._find_blocks()
        result.values = [
            values / rows
            for values, rows in zip(
                self.values, (result.row_levels(j) for j in range(self.n_outputs)), strict=True
            )
        ]
        return result

    def turned(self, turns: Sequence[Callable[[FloatArray], FloatArray]]) -> ModalRegression:
        """Return the regression with rows and values passed through a linear map for every output.

        Parameters
        ----------
        turns : sequence of callable -- from columns of an output, shape (n_rows, n), to as many rows
        """
        result = self._like()
        result.turns, result.unturned = tuple(turns), self
        result._find_blocks()
        result.values = [turn(own[:, None])[:, 0] for turn, own in zip(turns, self.values, strict=True)]
        return result

    def row_levels(self, output: int) -> FloatArray:
        """Return by what every sample of an output is divided, shape (n_samples,)."""
        sizes = [part.stop - part.start for _, part in self.segments[output]]
        return np.repeat([part[3] for part in self._parts[output]], sizes)

    @cached_property
    def pieces(self) -> tuple[ModalRegression, ...]:
        """The same regression cut in time, one record after the other; itself where every record is short or turned.

        A piece has rows of one stretch of one record, of all outputs, with the columns of the whole.
        """
        longest = max(part.stop - part.start for own in self.segments for _, part in own)
        if longest <= MAX_WHOLE or self.turns:
            return (self,)
        return tuple(piece for index in range(len(self._prepared)) for piece in self._pieces_of_record(index))

    def thinned(self, n_rows: int, seed: int = 0) -> ModalRegression:
        """Return the regression on a random choice of each record's stamps, where it has more of them.

        Parameters
        ----------
        n_rows : int -- stamps of a record that are kept, on each of its grids
        seed : int -- of the choice
        """
        rng = np.random.default_rng(seed)
        chosen = [
            [
                np.sort(rng.choice(len(g.times), n_rows, replace=False))
                if len(g.times) > n_rows
                else np.arange(len(g.times))
                for g in prepared.grids
            ]
            for prepared in self._prepared
        ]
        result = self._like()
        result.rate_hz = self.rate_hz
        result._prepared = [p.with_stamps(own) for p, own in zip(self._prepared, chosen, strict=True)]
        result._rows, result.own_columns, within = {}, {}, {}
        for key, rows in self._rows.items():
            stamps = chosen[key[0]][key[1]]
            result._rows[key] = np.flatnonzero(np.isin(stamps, rows, assume_unique=True))
            within[key] = np.searchsorted(rows, stamps[result._rows[key]])
        result.values, result.times, result.segments = [], [], []
        for parts, segments, values, times in zip(
            self._parts, self.segments, self.values, self.times, strict=True
        ):
            kept = [within[part[:3]] for part in parts]
            ends = np.cumsum([len(own) for own in kept]).tolist()
            rows = np.concatenate([own + whole.start for own, (_, whole) in zip(kept, segments, strict=True)])
            if (own_column := self.own_columns.get(len(result.values))) is not None:
                result.own_columns[len(result.values)] = own_column[rows]
            result.values.append(values[rows])
            result.times.append(times[rows])
            result.segments.append(
                [
                    (record, slice(end - len(own), end))
                    for own, end, (record, _) in zip(kept, ends, segments, strict=True)
                ]
            )
        result.places = [slice(0, len(values)) for values in result.values]
        return result

    def release(self) -> None:
        """Let go of what the inputs do between their samples; it is made anew when it is asked for."""
        for prepared in self._prepared:
            for driving in itertools.chain(*prepared.drivings.values()):
                driving.release()

    def _like(self) -> ModalRegression:
        """Return a copy without what belongs to its rows."""
        result = copy.copy(self)
        result._latest = None
        for known in ("pieces", "_seen_grids"):
            result.__dict__.pop(known, None)
        return result

    def _pieces_of_record(self, index: int) -> Iterator[ModalRegression]:
        prepared = self._prepared[index]
        longest = max((grid.times for grid in prepared.grids), key=len)
        # All grids are cut at the same instants.
        borders = longest[_PIECE_ROWS // 2 :: _PIECE_ROWS]
        cuts = [np.searchsorted(grid.times, borders) for grid in prepared.grids]
        ends = [
            np.concatenate([[0], cut, [len(g.times)]]) for cut, g in zip(cuts, prepared.grids, strict=True)
        ]
        for number in range(len(borders) + 1):
            own = [slice(int(end[number]), int(end[number + 1])) for end in ends]
            if any(rows.stop > rows.start for rows in own):
                yield self._piece(index, prepared.with_stamps(own), own)

    def _piece(self, index: int, stretch: _PreparedRecord, grid_rows: Sequence[slice]) -> ModalRegression:
        """Return the regression on some stamps of one record, no other record having any rows."""
        result = self._like()
        result._prepared = [stretch if k == index else p for k, p in enumerate(self._prepared)]
        result.record, result._rows, result.own_columns, within = index, {}, {}, {}
        for key, rows in self._rows.items():
            cut = grid_rows[key[1]] if key[0] == index else slice(0, 0)
            first, last = np.searchsorted(rows, [cut.start, cut.stop])
            within[key] = slice(int(first), int(last))
            result._rows[key] = rows[first:last] - cut.start
        result.values, result.times, result.segments, result.places = [], [], [], []
        for output, parts in enumerate(self._parts):
            segments = []
            place = slice(0, 0)
            for part, (record, whole) in zip(parts, self.segments[output], strict=True):
                here = within[part[:3]] if record == index else slice(0, 0)
                segments.append((record, slice(0, here.stop - here.start)))
                if record == index:
                    place = slice(whole.start + here.start, whole.start + here.stop)
            if (own_column := self.own_columns.get(output)) is not None:
                result.own_columns[output] = own_column[place]
            result.segments.append(segments)
            result.places.append(place)
            result.values.append(self.values[output][place])
            result.times.append(self.times[output][place])
        return result

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.output_names)

    @cached_property
    def _seen_grids(self) -> set[tuple[int, int]]:
        """Records and grids of stamps that have rows."""
        return {key[:2] for key, rows in self._rows.items() if len(rows)}

    @property
    def n_samples(self) -> int:
        """Number of output samples used, over all outputs."""
        return sum(len(v) for v in self.values)

    @property
    def drives(self) -> list[InputSignal]:
        """The input of every record, of all of them one after the other where records have several."""
        return [drive for drives in self.inputs for drive in drives]

    @property
    def n_forced(self) -> int:
        """Columns of a mode that inputs drive, one for each; its free responses follow."""
        return len(self.input_names)

    @property
    def n_fixed_of_input(self) -> int:
        """Number of columns (direct gain, residual term) of an input that no mode touches."""
        return int(self.structure.has_direct) + int(self.structure.has_residual)

    @property
    def n_shared_fixed(self) -> int:
        """Number of such columns of all inputs, which stand in front of the residues."""
        return self.n_forced * self.n_fixed_of_input

    def n_shared(self, n_modes: int) -> int:
        """Number of columns that records share: of gains, residual terms and residues."""
        return self.n_shared_fixed + self.n_forced * n_modes

    @property
    def duration_s(self) -> float:
        """Length of the longest record [s]."""
        return max(p.length for p in self._prepared)

    @cached_property
    def rate_hz(self) -> float:
        """Mean rate of the fastest output in one of its records, before any choice of stamps [Hz]."""
        return max(
            float(part.stop - part.start) / max(float(np.ptp(times[part])), 1e-12)
            for times, segments in zip(self.times, self.segments, strict=True)
            for _, part in segments
        )

    def n_columns(self, n_modes: int) -> int:
        """Number of linear parameters of an output that is in one record."""
        most = max(self.restarts.n_columns(n_modes, index) for index in range(len(self.inputs)))
        return self.n_shared(n_modes) + self.n_nuisance(n_modes) + most

    def n_nuisance(self, n_modes: int) -> int:
        """Number of columns that each record has for itself."""
        s = self.structure
        return int(s.has_offset) + int(s.has_ramp) + (2 * n_modes if s.has_free_response else 0)

    @property
    def n_parameters_of_a_mode(self) -> int:
        """Number of parameters that one more mode adds."""
        n_free = 2 if self.structure.has_free_response else 0
        n_anew = [
            sum(self.restarts.n_columns(1, part[0]) - self.restarts.n_columns(0, part[0]) for part in parts)
            for parts in self._parts
        ]
        return 2 + sum(
            self.n_forced + n_free * len(parts) + anew
            for parts, anew in zip(self._parts, n_anew, strict=True)
        )

    def restart_places(self, n_modes: int, output: int) -> list[tuple[InputGap, int, bool]]:
        """Return every restart at an output, the first of its columns, and whether free motions follow its drifts."""
        parts = self._parts[output]
        first = self.n_shared(n_modes) + self.n_nuisance(n_modes) * len(parts)
        found = []
        for gap, is_modal in (own for part in parts for own in self.restarts.of_record(part[0])):
            found.append((gap, first, is_modal))
            first += self.restarts.n_drifts + (2 * n_modes if is_modal else 0)
        return found

    def instants(self, clock: ClockState) -> list[FloatArray]:
        """Return when the samples of every output were taken, on the input's clock [s]."""
        return [
            np.concatenate(
                [
                    self._prepared[part[0]].instants(part[1], clock)[self._rows[part[:3]]]
                    for part in parts
                    if len(self._rows[part[:3]])
                ]
                or [np.empty(0)]
            )
            for parts in self._parts
        ]

    def initial_motions(self, omegas: FloatArray, zetas: FloatArray, clock: ClockState) -> list[FloatArray]:
        """Return what modes would do by themselves in each record, (n_rows, 2 n_modes n_records) of every output.

        Real and imaginary part of every mode, whether or not the structure has them, and not divided by levels.
        """
        poles = modal_poles(omegas, zetas)[:, None]
        found: dict[tuple[tuple[int, int, bytes, float], ...], FloatArray] = {}
        for parts, segments in zip(self._parts, self.segments, strict=True):
            if parts in found:
                continue
            columns = found[parts] = np.zeros((segments[-1][1].stop, 2 * len(omegas) * len(parts)))
            for number, (part, (_, here)) in enumerate(zip(parts, segments, strict=True)):
                prepared = self._prepared[part[0]]
                elapsed = prepared.instants(part[1], clock)[self._rows[part[:3]]] - prepared.start
                (free,) = free_motions(poles, elapsed, prepared.grids[part[1]].exposure_s, ())
                first = 2 * len(omegas) * number
                columns[here, first : first + 2 * len(omegas)] = np.concatenate([free.real, free.imag]).T
        return [found[parts] for parts in self._parts]

    def position_integrals(self, clock: ClockState) -> list[FloatArray]:
        """Return the integrals of what stands behind the direct gains, (n_samples, n_inputs) of every output."""
        return [
            np.concatenate(
                [
                    self._prepared[part[0]].position_integrals_at(part[1], clock)[self._rows[part[:3]]]
                    for part in parts
                ]
            )
            for parts in self._parts
        ]

    def blocks(
        self, omegas: FloatArray, zetas: FloatArray, clock: ClockState, gradients: bool
    ) -> list[ColumnBlock]:
        """Return the columns of every group of outputs that share stamps.

        Those of the latest point with gradients are kept: after a fit several tests look at its end.

        Columns stand in the order direct gain and residual term of every input, residues of all modes under the
        first input and under each other one, then for each record offset, ramp, and the real and imaginary free
        response of each mode; then for each restart its drifts, and the free responses again.
        """
        point = omegas.tobytes(), zetas.tobytes(), clock
        if self._latest is not None and self._latest[0] == point:
            found = self._latest[1]
        else:
            found = self._plain_blocks(omegas, zetas, clock, gradients)
            is_kept = gradients and self.record is None and sum(b.matrix.size for b in found) <= _MAX_KEPT
            self._latest = (point, found) if is_kept else None
        if not self.turns:
            return found
        return [
            block.turned(self.turns[own]) for block, (_, own) in zip(found, self._block_keys, strict=True)
        ]

    def _plain_blocks(
        self,
        omegas: FloatArray,
        zetas: FloatArray,
        clock: ClockState,
        gradients: bool,
        with_restarts: bool = True,
    ) -> list[ColumnBlock]:
        """Return the blocks before any turn of their rows."""
        cache = {
            (index, number): prepared.columns(number, omegas, zetas, clock, gradients, with_restarts)
            for index, prepared in enumerate(self._prepared)
            for number in range(len(prepared.grids))
            if (index, number) in self._seen_grids
        }
        together = {
            parts: self._assemble(parts, cache, len(omegas), gradients, with_restarts)
            for parts in dict.fromkeys(parts for parts, _ in self._block_keys)
        }
        return [self._extended(together[parts], own) for parts, own in self._block_keys]

    def _extended(self, block: ColumnBlock, output: int) -> ColumnBlock:
        """Return a block with the columns that its output has for itself, where there are any."""
        if output not in self.own_columns:
            return block
        columns = self.own_columns[output] / self.row_levels(output)[:, None]
        by_time = None if block.by_time is None else np.hstack([block.by_time, np.zeros_like(columns)])
        return replace(block, matrix=np.hstack([block.matrix, columns]), by_time=by_time)

    def candidates(self, omegas: FloatArray, zetas: FloatArray, clock: ClockState) -> list[FloatArray]:
        """Return the columns of single modes in every block, each (n_candidates, n_columns of a mode, n_rows).

        Where modes begin anew, what free motion since then explains is taken out: a bridge that nobody believes
        leaves nothing else there.
        """
        steady = self.with_changes(()) if self.structure.changes else self
        blocks = steady._plain_blocks(omegas, zetas, clock, gradients=False, with_restarts=False)
        found = [block.matrix.T[block.mode_columns] for block in blocks]
        poles = modal_poles(omegas, zetas)[:, None]
        for columns, (parts, _) in zip(found, self._block_keys, strict=True):
            first = 0
            for part in parts:
                rows = self._rows[part[:3]]
                gaps = [gap for gap, is_modal in self.restarts.of_record(part[0]) if is_modal]
                if gaps and len(rows):
                    instants = self._prepared[part[0]].instants(part[1], clock)[rows]
                    middles = [gap.middle_s for gap in gaps]
                    places = [*np.searchsorted(instants, middles, side="right"), len(rows)]
                    for gap, low, high in zip(gaps, places[:-1], places[1:], strict=True):
                        free = np.exp(poles * (instants[low:high] - gap.end_s))
                        _take_out(columns[:, :, first + low : first + high], free)
                first += len(rows)
        if not self.turns:
            return found
        return [
            turned_candidates(columns, self.turns[own])
            for columns, (_, own) in zip(found, self._block_keys, strict=True)
        ]

    def _assemble(
        self,
        parts: tuple[tuple[int, int, bytes, float], ...],
        cache: dict[tuple[int, int], _GridColumns],
        n_modes: int,
        gradients: bool,
        with_restarts: bool,
    ) -> ColumnBlock:
        structure, n_forced = self.structure, self.n_forced
        n_shared, n_own = self.n_shared(n_modes), self.n_nuisance(n_modes)
        lengths = [len(self._rows[part[:3]]) for part in parts]
        # Of every part, how its columns begin anew: with the modes, or with constants of integration alone.
        anew = [self.restarts.of_record(part[0]) if with_restarts else () for part in parts]
        n_columns = n_shared + n_own * len(parts)
        begin, n_free = n_columns, 2 * len(parts) if structure.has_free_response else 0
        if with_restarts:
            n_columns += sum(self.restarts.n_columns(n_modes, part[0]) for part in parts)
        n_touched = n_forced + n_free + 2 * sum(is_modal for own in anew for _, is_modal in own)
        block = BlockRows(sum(lengths), n_columns, n_modes, n_touched, gradients)
        block.begin_residues(self.n_shared_fixed, n_forced)
        first, touches = 0, n_forced + n_free
        for number, (part, length) in enumerate(zip(parts, lengths, strict=True)):
            here, rows = slice(first, first + length), self._rows[part[:3]]
            first += length
            own = n_shared + n_own * number
            pair = own + int(structure.has_offset) + int(structure.has_ramp)
            free_at = [(pair, n_forced + 2 * number)] if n_free else []
            restarts = []  # where free motions begin, among the columns and among those that a mode touches
            for _, is_modal in anew[number]:
                begin += self.restarts.n_drifts
                restarts.append((begin, touches))
                if is_modal:
                    free_at.append((begin, touches))
                    begin, touches = begin + 2 * n_modes, touches + 2
            block.begin_free_motions(free_at)
            if length:
                source = cache[part[0], part[1]]
                self._fill(block.part(here, rows, source.ramp), source, own, number, restarts)
                block.divide(here, part[3])
        return block.done()

    def _fill(
        self,
        part: BlockPart,
        source: _GridColumns,
        own: int,
        number: int,
        restarts: Sequence[tuple[int, int]],
    ) -> None:
        """Fill the rows of one part of a block.

        Parameters
        ----------
        part : BlockPart
        source : _GridColumns -- of its stamps
        own : int -- the first of its own columns
        number : int -- of the part
        restarts : sequence of tuple of int -- where free motions begin anew, among the columns and among those that a
            mode touches
        """
        structure = self.structure
        part.set_clock(source.sampling.latency_factor, source.sampling.rate_factor)
        for column, (value, rate) in enumerate(source.sampling.fixed):
            part.set(column, value, rate)
        if structure.has_offset:
            part.set(own)
            own += 1
        if structure.has_ramp:
            part.set(own, source.ramp)
            own += 1
        part.set_residues(self.n_shared_fixed, source.forced)
        if structure.has_free_response:
            part.set_free_motions(own, self.n_forced + 2 * number, source.free)
        for restart, (free, place) in zip(source.restarts, restarts, strict=True):
            for column, (value, rate) in enumerate(restart.drifts, free - len(restart.drifts)):
                part.set(column, value, rate)
            part.set_free_motions(free, place, restart.free)


def turned_candidates(columns: FloatArray, turn: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return columns of single modes, (n_candidates, n_columns, n_rows), with rows passed through a linear map."""
    return np.reshape(turn(columns.reshape(-1, columns.shape[2]).T).T, columns.shape)


def _take_out(columns: FloatArray, free: ComplexArray) -> None:
    """Take the real and imaginary parts of a free motion out of some columns, each by its own mode.

    Parameters
    ----------
    columns : ndarray, shape (n_modes, n_columns, n) -- changed in place
    free : ndarray, shape (n_modes, n)
    """
    pairs = np.stack([free.real, free.imag], axis=1)
    gram = pairs @ pairs.transpose(0, 2, 1)
    # Of one sample or two both parts look alike, or nothing is left of a damped motion.
    gram += (1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300) * np.eye(2)
    shares = np.linalg.solve(gram, pairs @ columns.transpose(0, 2, 1))
    columns -= shares.transpose(0, 2, 1) @ pairs


def forced_columns(
    drives: Sequence[InputSignal],
    structure: ModalStructure,
    times_s: FloatArray,
    exposure_s: float,
    omegas: FloatArray,
    zetas: FloatArray,
) -> FloatArray:
    """Return direct, residual and modal columns of all inputs from rest, shape (n_times, n_shared)."""
    half = 0.5 * exposure_s
    for drive in drives:
        first, last = drive.span_s
        if len(times_s) and (np.min(times_s) - half < first - 1e-9 or np.max(times_s) + half > last + 1e-9):
            raise EstimationError(
                f"instants from {np.min(times_s) - half:.6f} to {np.max(times_s) + half:.6f} s, exposure "
                f"included, are asked for; input {drive.name!r} is known from {first:.6f} to {last:.6f} s"
            )
    output = OutputSignal("instants", "", times_s, np.zeros(len(times_s)), exposure_s)
    prepared = _PreparedRecord(TimeRecord(tuple(drives), (output,)), drives, structure)
    columns = prepared.columns(0, omegas, zetas, ClockState(), gradients=False)
    return np.column_stack([value for value, _ in columns.sampling.fixed] + list(columns.forced[0]))
