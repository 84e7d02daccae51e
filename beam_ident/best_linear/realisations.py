"""Realisations of a periodic excitation side by side: which there are, and what their steady periods show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.arrays import BoolArray, ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import require_records, require_whole_number
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.responses.periodic_averaging import PeriodicResponse, periodic_response
from beam_ident.responses.steady_periods import drift_of_periods

_ALIKE = 0.9  # of the largest correlation that two multisines can have: they are one, begun at another time
_REPEATS = 1e-6  # of an input's amplitude: what changes less repeats
_PROVEN = 0.5  # of the scatter, that a drifting delay explains: then it is no noise
_ENOUGH_LINES = 8  # by which two multisines can be told from each other
_TESTABLE = 3  # periods of which drift can be told from noise


@dataclass(frozen=True, eq=False)
class Realisations:
    """Mean spectra at all lines that some realisation excites, and what periods scatter about them."""

    found: tuple[PeriodicResponse, ...]
    numbers: IndexArray  # (n_lines,)
    is_excited: BoolArray  # (M, n_lines)
    outputs: ComplexArray  # (M, n_outputs, n_lines), means over the periods
    inputs: ComplexArray  # (M, n_lines)
    instruments: ComplexArray  # (M, n_lines), the reference, or the input itself
    scatter: ComplexArray  # (M, n_lines, n_outputs + 1, n_outputs + 1), sums of squares of outputs and input
    n_periods: IndexArray  # (M,)


def realisations_of(
    records: TimeRecord | Sequence[TimeRecord], windows_s: Sequence[tuple[float, float]] | None
) -> list[tuple[TimeRecord, float, float]]:
    """Return every realisation as a record, its start and its end [s]."""
    given = require_records(records)
    windows = [(-np.inf, np.inf)] * len(given) if windows_s is None else [tuple(own) for own in windows_s]
    if len(given) == 1:
        given = given * len(windows)
    if len(given) != len(windows) or not all(len(own) == 2 and own[0] < own[1] for own in windows):
        raise EstimationError(
            f"{len(windows)} windows for {len(given)} records: {windows!r:.80}; expected (start, end) in s with "
            "start before end, one for each record, or those of one record"
        )
    if len(given) < 2:
        raise EstimationError(
            f"there is one realisation, {given[0].name!r}: what is distortion and what is response cannot be told "
            "apart at its lines. Record at least two, better seven, with other seeds; a single one with detection "
            "lines can be judged by nonlinear_distortion()"
        )
    return [(record, start, end) for record, (start, end) in zip(given, windows, strict=True)]


def chosen_input_name(record: TimeRecord, input_name: str | None, reference_name: str | None) -> str:
    """Return the name of the input that is meant."""
    names = [own.name for own in record.inputs]
    if reference_name is not None and (
        len(names) < 2 or reference_name not in names or reference_name == input_name
    ):
        raise EstimationError(
            f"reference_name is {reference_name!r}; expected an input of record {record.name!r} beside the one that "
            f"is meant, of {', '.join(names)}"
        )
    others = [name for name in names if name != reference_name]
    chosen = others if input_name is None else [name for name in names if name == input_name]
    if len(chosen) != 1:
        raise EstimationError(
            f"record {record.name!r} has the inputs {', '.join(names)} and input_name is {input_name!r}; expected "
            "the name of one of them"
        )
    return chosen[0]


def lines_of_each(excited_hz: Any, n: int) -> list[FloatArray | None]:
    """Return the excited lines of every realisation [Hz], None where they are to be found."""
    if excited_hz is None:
        return [None] * n
    is_one = np.ndim(excited_hz[0]) == 0 if len(excited_hz) else True
    lines = [excited_hz] * n if is_one else list(excited_hz)
    if len(lines) != n:
        raise EstimationError(
            f"excited_hz has lines of {len(lines)} realisations; expected those of {n}, or of all"
        )
    return lines


def settled_responses(
    parts: Sequence[tuple[TimeRecord, float, float]],
    line_period_s: float,
    lines: Sequence[FloatArray | None],
    skip_periods: int | None,
    output_names: Sequence[str] | None,
    input_name: str,
) -> tuple[int, list[PeriodicResponse]]:
    """Return how many periods are left out at every beginning, and the responses from the others."""

    def after(skip: int) -> list[PeriodicResponse]:
        return [
            periodic_response(
                record, line_period_s, own, start + skip * line_period_s, end, output_names, input_name
            )
            for (record, _, end), start, own in zip(parts, starts, lines, strict=True)
        ]

    starts = [start for _, start, _ in parts]
    found = after(0)
    # Whole periods are counted from where the first one begins, less what a stamp may lack in its last digit.
    starts = [one.first_s - 1e-6 for one in found]
    if skip_periods is not None:
        require_whole_number("skip_periods", skip_periods, 0, 10**6)
        return skip_periods, after(skip_periods) if skip_periods else found
    fewest = min(one.n_periods for one in found)
    skip = int(fewest > 2)
    found = after(skip) if skip else found
    while unsteadiness(found) and fewest - skip > _TESTABLE:
        skip += 1
        found = after(skip)
    return skip, found


def unsteadiness(found: Sequence[PeriodicResponse]) -> float:
    """Return the drift of the periods of all realisations together, 0 where noise explains it.

    Notes
    -----
    Transients of a lightly damped structure stand on few lines: those of one realisation prove little.
    """
    fewest = min(one.n_periods for one in found)
    drift, is_unsteady = drift_of_periods(
        np.concatenate([one.bin_outputs[:, -fewest:] for one in found], axis=2)
    )
    return float(np.max(drift[is_unsteady], initial=0.0))


def require_repetition(found: Sequence[PeriodicResponse]) -> None:
    """Raise EstimationError where less than half of an input's power at its lines repeats."""
    for one in found:
        drive = one.line_inputs
        scatter = float(np.sum(np.var(drive, axis=0, ddof=1)))
        repeated = float(np.sum(np.abs(np.mean(drive, axis=0)) ** 2)) - scatter / one.n_periods
        if repeated < scatter:
            share = max(repeated, 0.0) / max(repeated + scatter, 1e-300)
            raise EstimationError(
                f"record {one.response.name!r}: {share:.0%} of the power of {one.response.input_names[0]!r} repeats "
                f"after {one.line_period_s:.6g} s; expected a periodic excitation, as a multisine. Give its period; "
                "of another excitation take local_polynomial_response() or identify()"
            )
        later, share = _lateness(one)
        if share > _PROVEN:
            raise EstimationError(
                f"record {one.response.name!r}: {one.response.input_names[0]!r} comes {later * 1e3:.3g} ms later "
                f"from period to period of {one.line_period_s:.9g} s; expected what repeats. Its period may be "
                f"{one.line_period_s + later:.9g} s, by the clock of the record"
            )


def _lateness(found: PeriodicResponse) -> tuple[float, float]:
    """Return how much later an input comes by the period [s], and the share of its periods' scatter that explains.

    Notes
    -----
    U_p = U e^(-j w d p) is, for small delays d p about the middle, U (1 - j w d p). Little data prove nothing.
    """
    drive, omegas = found.line_inputs, found.response.omegas
    mean = np.mean(drive, axis=0)
    apart = drive - mean
    slope = -1j * omegas * mean * (np.arange(len(drive)) - 0.5 * (len(drive) - 1))[:, None]
    scatter, power = float(np.sum(np.abs(apart) ** 2)), float(np.sum(np.abs(slope) ** 2))
    is_exact = scatter <= _REPEATS**2 * float(np.sum(np.abs(drive) ** 2))
    if is_exact or power <= 0.0 or drive.size - len(omegas) < _ENOUGH_LINES:
        return 0.0, 0.0
    later = float(np.sum(np.conj(slope) * apart).real) / power
    return later, later**2 * power / scatter


def require_differences(found: Sequence[PeriodicResponse]) -> None:
    """Raise EstimationError where two realisations are one, perhaps begun at another time."""
    spectra = []
    top = max(int(line_numbers(one)[-1]) for one in found)
    for one in found:
        row = np.zeros(top + 1, dtype=np.complex128)
        # Phases alone: of a spectrum that falls, a line or two would be all of the correlation.
        row[line_numbers(one)] = np.exp(1j * np.angle(np.mean(one.line_inputs, axis=0)))
        spectra.append(row)
    for second in range(1, len(found)):
        for first in range(second):
            both = spectra[first] * np.conj(spectra[second])
            common, n = np.count_nonzero(both), 8 * (top + 1)
            if common >= _ENOUGH_LINES and np.max(np.abs(np.fft.ifft(both, n))) * n > _ALIKE * common:
                raise EstimationError(
                    f"realisations {first + 1} and {second + 1} ({found[second].response.name!r}) are the same "
                    "signal: distortion repeats with it and looks like response. Excite with random phases, and with "
                    "another seed in every realisation"
                )


def line_numbers(found: PeriodicResponse) -> IndexArray:
    """Return the numbers of a response's lines."""
    return np.asarray(np.rint(found.response.omegas * found.line_period_s / (2.0 * np.pi)), dtype=np.intp)


def side_by_side(found: Sequence[PeriodicResponse], references: Sequence[PeriodicResponse]) -> Realisations:
    """Put realisations side by side, at all lines that two of them excite and share with no other line."""
    own = [line_numbers(one) for one in found]
    usable = [
        np.intersect1d(numbers[~one.is_shared], line_numbers(other)[~other.is_shared])
        for numbers, one, other in zip(own, found, references, strict=True)
    ]
    every, counts = np.unique(np.concatenate(usable), return_counts=True)
    numbers = every[counts > 1]
    if not len(numbers):
        raise EstimationError(
            "no line is excited in two realisations without another line that folds onto it; excite the same lines "
            "in all of them, up to half the rate of the outputs"
        )
    M, n_lines, n_outputs = len(found), len(numbers), found[0].line_outputs.shape[0]
    is_excited = np.zeros((M, n_lines), dtype=bool)
    outputs = np.zeros((M, n_outputs, n_lines), dtype=np.complex128)
    inputs, instruments = (np.zeros((M, n_lines), dtype=np.complex128) for _ in range(2))
    scatter = np.zeros((M, n_lines, n_outputs + 1, n_outputs + 1), dtype=np.complex128)
    for m, (one, other) in enumerate(zip(found, references, strict=True)):
        place = np.flatnonzero(np.isin(numbers, usable[m]))
        at, of_reference = (np.searchsorted(line_numbers(each), numbers[place]) for each in (one, other))
        both = np.concatenate([one.line_outputs[:, :, at], one.line_inputs[None, :, at]])
        mean = np.mean(both, axis=1)
        apart = both - mean[:, None]
        is_excited[m, place] = True
        outputs[m][:, place], inputs[m, place] = mean[:-1], mean[-1]
        instruments[m, place] = np.mean(other.line_inputs[:, of_reference], axis=0)
        scatter[m, place] = np.einsum("apl,bpl->lab", apart, np.conj(apart))
    n_periods = np.array([one.n_periods for one in found])
    return Realisations(tuple(found), numbers, is_excited, outputs, inputs, instruments, scatter, n_periods)
