"""A start without hints: by how much one more mode would raise the likelihood, over a band.

For every candidate the columns of one mode, forced and free, are projected onto the complement of the
present model, and the gain in likelihood over all outputs is noted.

In time records the grid of frequencies is as fine as the damping that it is scanned with is wide; the best
candidate is then refined on a finer grid over frequency and damping.  That scan works on thinned data, the
fit that follows on all of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.data.argument_checks import chosen_inputs
from beam_ident.data.bandwidth import Band
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.restarts import Restarts
from beam_ident.modal.structure import ModalStructure, StructureKind
from beam_ident.modal_estimation.variable_projection import ModalProblem
from beam_ident.numerics.linear_least_squares import LinearSolution

SCAN_DAMPING = 0.015
Family = tuple[FloatArray, FloatArray]  # frequencies [rad/s] and damping ratios, both (n_candidates,)

_BESIDE = 2.5 * SCAN_DAMPING  # of a frequency: where one has been tried in vain
_RIVAL = 0.5  # of the best candidate's gain: a scan with all else held does not decide between families
_MAX_STAMPS = 1500  # of a record
_FEW_STAMPS = 200  # of each of many records, which share twice as many
_OTHER_LEVELS = 0.1  # by which levels differ so much that the scan is made anew
_MAX_POINTS = 900
_CHUNK = 64
_STATES = 8_000_000  # of all candidates of a chunk, at the knots of the input
_FEW = 32  # candidates at once: what fits into the cache is several times quicker
_FINE_DAMPINGS = (0.003, 0.015, 0.08)
_TANGLED = 0.1  # of a forced column: what is left beside free motion
_RIDGE = 1e-6  # on columns of unit length
_SAMPLES_PER_CYCLE = 7  # joined by a cubic spline


@dataclass(frozen=True)
class Candidate:
    """A mode that the scan proposes: frequency [rad/s], damping ratio, gain in log-likelihood."""

    omega: float
    zeta: float
    gain: float


def likelihood_gains(
    problem: ModalProblem, fit: ModalFit, omegas: FloatArray, zetas: FloatArray
) -> FloatArray:
    """Return by how much each candidate mode would raise the log-likelihood, with all poles of a fit held.

    Parameters
    ----------
    problem : ModalProblem
    fit : ModalFit -- the modes there are
    omegas, zetas : ndarray, shape (n_candidates,) -- [rad/s], [-]
    """
    complement, gains = _Complement(problem, fit), []
    for first in range(0, len(omegas), _FEW):
        few = slice(first, first + _FEW)
        columns = problem.candidates(omegas[few], zetas[few], fit.clock)
        gains.append(complement.gains([_Candidates.of(own) for own in columns]))
    return np.concatenate(gains)


def rivals(
    problem: ModalProblem, fit: ModalFit, families: Sequence[Family], excluded: Sequence[float]
) -> list[Candidate]:
    """Return the best candidate of every family that promises enough.

    Parameters
    ----------
    problem : ModalProblem
    fit : ModalFit -- the present model
    families : sequence of Family
        Candidates of different families may be each other's aliases: fits decide between them.
    excluded : sequence of float -- frequencies [rad/s] whose neighbourhood has been tried in vain
    """
    omegas, zetas = (np.concatenate([family[k] for family in families]) for k in range(2))
    gains = _without(likelihood_gains(problem, fit, omegas, zetas), omegas, excluded)
    best, first = [], 0
    for family in families:
        place = first + int(np.argmax(gains[first : first + len(family[0])]))
        first += len(family[0])
        if np.isfinite(gains[place]) and gains[place] >= _RIVAL * np.max(gains):
            best.append(Candidate(float(omegas[place]), float(zetas[place]), float(gains[place])))
    return best


def _without(gains: FloatArray, omegas: FloatArray, excluded: Sequence[float]) -> FloatArray:
    """Return gains, those beside excluded frequencies minus infinity."""
    for omega in excluded:
        gains = np.where(np.abs(np.log(omegas / omega)) < _BESIDE, -np.inf, gains)
    return gains


class ModalScan:
    """Gain in likelihood of one more mode, over a band.

    Parameters
    ----------
    records : sequence of TimeRecord
    structure : ModalStructure
    input_name : str, sequence of str or None -- as of ``ModalRegression``
    band : Band
    restarts : Restarts -- the gaps of the inputs after which the modes begin anew
    seed : int
        Seed of the choice of stamps where there are too many.
    """

    def __init__(
        self,
        records: Sequence[TimeRecord],
        structure: ModalStructure,
        input_name: str | Sequence[str] | None,
        band: Band,
        restarts: Restarts,
        seed: int = 0,
    ) -> None:
        self.band = band
        inputs = [chosen_inputs(r, input_name) for r in records]
        longest = 1.0 / (_SAMPLES_PER_CYCLE * band.high_hz)
        if any(d.period_s is None or d.period_s < 0.75 * longest for drives in inputs for d in drives):
            inputs = [tuple(_thinned_input(d, structure, longest) for d in drives) for drives in inputs]
            if structure.has_direct:
                kind: StructureKind = "base_motion" if structure.is_motion else "accelerance"
                structure = dataclasses.replace(structure, kind=kind)
        most = min(_MAX_STAMPS, max(2 * _MAX_STAMPS // len(records), _FEW_STAMPS))
        thinned = [_thinned_record(r, d, seed, most) for r, d in zip(records, inputs, strict=True)]
        self._plain = self.regression = ModalRegression(thinned, structure, restarts=restarts)
        step = min(SCAN_DAMPING, np.log(band.high_hz / band.low_hz) / 8.0)
        n_points = int(min(_MAX_POINTS, np.ceil(np.log(band.high_hz / band.low_hz) / step) + 1))
        self.omegas = 2.0 * np.pi * np.geomspace(band.low_hz, band.high_hz, n_points)
        self._candidates: list[_Candidates] | None = None
        self._levels: list[FloatArray] = []
        self._turned: ModalRegression | None = None
        self._clock = ClockState()

    def weigh(self, levels: Sequence[FloatArray]) -> None:
        """Divide the rows of every output by a level in each of its records (``ModalRegression.weighed``)."""
        known = self._levels
        if known and all(np.allclose(a, b, rtol=_OTHER_LEVELS) for a, b in zip(known, levels, strict=True)):
            return
        self._levels = list(levels)
        self.regression = self._plain.weighed(levels)
        self._turned = self._candidates = None

    def turn(self, turned: Callable[[ModalRegression], ModalRegression]) -> None:
        """Look for modes in rows of the regression that are passed through linear maps."""
        self._turned, self._candidates = turned(self._plain), None

    @property
    def is_tangled(self) -> bool:
        """Whether what the input causes looks like free motion: a blow that starts the record does.

        Notes
        -----
        What the free columns of a mode, and those that no mode touches, do not explain of its forced column is what
        its residue is known by. Where that is less than a tenth at most frequencies, free motion makes the
        standard deviation of a residue ten times as large.
        """
        regression = self.regression
        if not regression.structure.has_free_response:
            return False
        omegas = self.omegas[:: max(1, len(self.omegas) // _FEW)]
        parts = []
        none = np.empty(0)
        candidates = regression.candidates(omegas, np.full_like(omegas, SCAN_DAMPING), self._clock)
        fixed = [block.matrix for block in regression.blocks(none, none, self._clock, gradients=False)]
        for columns, others in zip(candidates, fixed, strict=True):
            for own in columns:
                forced = own[: regression.n_forced].T
                free = LinearSolution.of(np.concatenate([own[regression.n_forced :].T, others], axis=1)).basis
                left = np.linalg.norm(forced - free @ (free.T @ forced), axis=0)
                parts += (left / np.maximum(np.linalg.norm(forced, axis=0), 1e-300)).tolist()
        return float(np.median(parts)) < _TANGLED

    def gains(self, model: ModalFit, complement: _Complement | None = None) -> FloatArray:
        """Return the gain in log-likelihood over the grid, shape (n_points,); ``complement`` is that of the model."""
        clock = model.clock
        moved = abs(clock.latency - self._clock.latency) * self.omegas[-1] > 1.0
        if self._candidates is None or moved:
            self._candidates = self._prepare(self.omegas, np.full_like(self.omegas, SCAN_DAMPING), clock)
            self._clock = clock
        complement = complement or _Complement(self._turned or self.regression, model)
        return complement.gains(self._candidates)

    def propose(self, model: ModalFit, excluded: Sequence[float] = ()) -> Candidate | None:
        """Return the most promising further mode, or None when the band is used up.

        Parameters
        ----------
        model : ModalFit -- the present model
        excluded : sequence of float
            Frequencies [rad/s] whose neighbourhood has been tried in vain.
        """
        complement = _Complement(self._turned or self.regression, model)
        gains = _without(self.gains(model, complement), self.omegas, excluded)
        best = int(np.argmax(gains))
        if not np.isfinite(gains[best]):
            return None
        fine = self.omegas[best] * np.exp(np.linspace(-1.2, 1.2, 15) * SCAN_DAMPING)
        omegas = np.tile(fine, len(_FINE_DAMPINGS))
        zetas = np.repeat(_FINE_DAMPINGS, len(fine))
        refined = complement.gains(self._prepare(omegas, zetas, model.clock))
        winner = int(np.argmax(refined))
        return Candidate(float(omegas[winner]), float(zetas[winner]), float(refined[winner]))

    def _prepare(self, omegas: FloatArray, zetas: FloatArray, clock: ClockState) -> list[_Candidates]:
        """Return the columns of candidates for every block of outputs that share stamps."""
        knots = max(len(drive.times_s) for drive in self.regression.drives)
        n_at_once = min(_CHUNK, max(_STATES // knots, _FEW // 4))
        chunks = [slice(first, first + n_at_once) for first in range(0, len(omegas), n_at_once)]
        regression = self._turned or self.regression
        found = [regression.candidates(omegas[part], zetas[part], clock) for part in chunks]
        return [_Candidates.of(np.concatenate(parts)) for parts in zip(*found, strict=True)]


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Columns of single modes, each of unit length, and how those of one mode overlap.

    Attributes
    ----------
    rows : ndarray, shape (n_candidates * width, n_rows) -- forced, and free where there are such
    gram : ndarray, shape (n_candidates, width, width) -- with a ridge
    """

    rows: FloatArray
    gram: FloatArray

    @staticmethod
    def of(columns: FloatArray) -> _Candidates:
        """Scale columns of shape (n_candidates, width, n_rows)."""
        norms = np.sqrt(np.einsum("gan,gan->ga", columns, columns))
        columns = columns / np.where(norms > 0.0, norms, 1.0)[:, :, None]
        gram = columns @ columns.transpose(0, 2, 1) + _RIDGE * np.eye(columns.shape[1])
        return _Candidates(columns.reshape(-1, columns.shape[2]), gram)


class _Complement:
    """What the columns of a fit, with its poles held, leave of the data."""

    def __init__(self, problem: ModalProblem, fit: ModalFit) -> None:
        self.problem = problem
        blocks = problem.blocks(fit.omegas, fit.zetas, fit.clock, gradients=False)
        self.bases = [LinearSolution.of(block.matrix).basis for block in blocks]
        owners = zip(problem.values, problem.block_of, strict=True)
        self.residuals = [values - self.bases[own] @ (self.bases[own].T @ values) for values, own in owners]

    def gains(self, candidates: Sequence[_Candidates]) -> FloatArray:
        """Return the gain in log-likelihood of every candidate.

        Notes
        -----
        A candidate's columns C lower the residual sum of squares by ``b^T G^-1 b``, ``b = C^T r`` and
        ``G = C^T P C``, with the residuals r and the projection ``P = 1 - Q Q^T`` of (I.8).
        """
        problem = self.problem
        total = np.zeros(len(candidates[0].gram))
        for number, (basis, candidate) in enumerate(zip(self.bases, candidates, strict=True)):
            shape = candidate.gram.shape[:2]
            inside = (candidate.rows @ basis).reshape(*shape, -1)
            gram = candidate.gram - inside @ inside.transpose(0, 2, 1)
            for residual, own in zip(self.residuals, problem.block_of, strict=True):
                if own != number:
                    continue
                projected = (candidate.rows @ residual).reshape(shape)
                explained = np.einsum(
                    "ga,ga->g", projected, np.linalg.solve(gram, projected[:, :, None])[:, :, 0]
                )
                if problem.is_noise_known:
                    total += 0.5 * explained
                    continue
                share = np.clip(explained / max(float(residual @ residual), 1e-300), 0.0, 1.0 - 1e-15)
                total -= 0.5 * len(residual) * np.log1p(-share)
        return total


def _thinned_input(drive: InputSignal, structure: ModalStructure, longest: float) -> InputSignal:
    """Return an input on a regular, not too dense grid, joined by a cubic spline.

    Whatever is integrated twice on its way to the outputs is thinned after the
    integration, as a position: thinned before, its double integral would drift.
    """
    signal = drive.signal()
    for _ in range(2 - structure.differentiations if structure.has_direct else 0):
        signal = signal.antiderivative()
    first, last = drive.span_s
    n = int(max(np.floor((last - first) / longest), 64)) + 1
    step = (last - first) / (n - 1)
    values = signal(np.asarray(first + step * np.arange(n), dtype=np.float64))
    grid: Any = (first, step)
    return InputSignal(drive.name, drive.unit, grid, values, "cubic", gaps=drive.gaps)


def _thinned_record(record: TimeRecord, drives: tuple[InputSignal, ...], seed: int, most: int) -> TimeRecord:
    """Return a record with other inputs and at most so many stamps."""
    rng = np.random.default_rng(seed)
    outputs = []
    chosen: dict[bytes, IndexArray] = {}
    for output in record.outputs:
        key = output.times_s.tobytes()
        if key not in chosen:
            n = len(output.times_s)
            chosen[key] = np.arange(n) if n <= most else np.sort(rng.choice(n, most, replace=False))
        keep = chosen[key]
        if np.count_nonzero(output.is_valid[keep]) < 20:
            keep = np.flatnonzero(output.is_valid)[:most]
        outputs.append(dataclasses.replace(output, times_s=output.times_s[keep], values=output.values[keep]))
    return TimeRecord(drives, tuple(outputs), record.start_ns, record.name)
