"""A start without hints: scan one more mode over the input's band.

For every candidate frequency the forced and the free response of one mode are
projected onto the complement of the present model, and the gain in likelihood over
all outputs is noted.  The grid is as fine as the damping that it is scanned with is
wide; the best candidate is then refined on a finer grid over frequency and damping.
The scan works on thinned data, the fit that follows on all of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.data.bandwidth import Band
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.variable_projection import ModalFit

SCAN_DAMPING = 0.015

_MAX_STAMPS = 1500
_MAX_POINTS = 900
_CHUNK = 160
_FINE_DAMPINGS = (0.003, 0.015, 0.08)
_RIDGE = 1e-6  # on columns of unit length
_SAMPLES_PER_CYCLE = 7  # joined by a cubic spline


@dataclass(frozen=True)
class Candidate:
    """A mode that the scan proposes: frequency [rad/s], damping ratio, gain in log-likelihood."""

    omega: float
    zeta: float
    gain: float


class ModalScan:
    """Gain in likelihood of one more mode, over a band.

    Parameters
    ----------
    records : sequence of TimeRecord
    structure : ModalStructure
    input_name : str or None
    band : Band
    seed : int
        Seed of the choice of stamps where there are too many.
    """

    def __init__(
        self,
        records: Sequence[TimeRecord],
        structure: ModalStructure,
        input_name: str | None,
        band: Band,
        seed: int = 0,
    ) -> None:
        self.band = band
        drives = [r.inputs[0] if input_name is None else r.input(input_name) for r in records]
        longest = 1.0 / (_SAMPLES_PER_CYCLE * band.high_hz)
        if any(d.period_s is None or d.period_s < 0.75 * longest for d in drives):
            drives = [_thinned_input(d, structure, longest) for d in drives]
            if structure.has_direct:
                structure = dataclasses.replace(structure, kind="base_motion")
        thinned = [_thinned_record(r, d, seed) for r, d in zip(records, drives, strict=True)]
        self._plain = self.regression = ModalRegression(thinned, structure)
        step = min(SCAN_DAMPING, np.log(band.high_hz / band.low_hz) / 8.0)
        n_points = int(min(_MAX_POINTS, np.ceil(np.log(band.high_hz / band.low_hz) / step) + 1))
        self.omegas = 2.0 * np.pi * np.geomspace(band.low_hz, band.high_hz, n_points)
        self._candidates: list[_Candidates] | None = None
        self._clock = ClockState()

    def weigh(self, levels: Sequence[FloatArray]) -> None:
        """Divide the rows of every output by a level in each of its records (``ModalRegression.weighed``)."""
        self.regression = self._plain.weighed(levels)
        self._candidates = None

    def gains(self, model: ModalFit) -> FloatArray:
        """Return the gain in log-likelihood over the grid, shape (n_points,)."""
        clock = model.clock
        moved = abs(clock.latency - self._clock.latency) * self.omegas[-1] > 1.0
        if self._candidates is None or moved:
            self._candidates = self._prepare(self.omegas, np.full_like(self.omegas, SCAN_DAMPING), clock)
            self._clock = clock
        return self._gains_of(self._candidates, model)

    def propose(self, model: ModalFit, excluded: Sequence[float] = ()) -> Candidate | None:
        """Return the most promising further mode, or None when the band is used up.

        Parameters
        ----------
        model : ModalFit -- the present model
        excluded : sequence of float
            Frequencies [rad/s] whose neighbourhood has been tried in vain.
        """
        gains = self.gains(model)
        for omega in excluded:
            gains = np.where(np.abs(np.log(self.omegas / omega)) < 2.5 * SCAN_DAMPING, -np.inf, gains)
        best = int(np.argmax(gains))
        if not np.isfinite(gains[best]):
            return None
        fine = self.omegas[best] * np.exp(np.linspace(-1.2, 1.2, 15) * SCAN_DAMPING)
        omegas = np.tile(fine, len(_FINE_DAMPINGS))
        zetas = np.repeat(_FINE_DAMPINGS, len(fine))
        refined = self._gains_of(self._prepare(omegas, zetas, model.clock), model)
        winner = int(np.argmax(refined))
        return Candidate(float(omegas[winner]), float(zetas[winner]), float(refined[winner]))

    def _prepare(self, omegas: FloatArray, zetas: FloatArray, clock: ClockState) -> list[_Candidates]:
        """Return the columns of candidates for every block of outputs that share stamps."""
        structure, regression = self.regression.structure, self.regression
        n_fixed = regression.n_shared_fixed
        collected: list[list[FloatArray]] = []
        for first in range(0, len(omegas), _CHUNK):
            part = slice(first, first + _CHUNK)
            n = len(omegas[part])
            blocks = regression.blocks(omegas[part], zetas[part], clock, gradients=False)
            for number, block in enumerate(blocks):
                rows = block.matrix.T
                pieces = [rows[n_fixed : n_fixed + n, None]]
                if structure.has_free_response:
                    n_own = regression.n_nuisance(n)
                    for own in range(n_fixed + n, len(rows), n_own):
                        pairs = rows[own + n_own - 2 * n : own + n_own]
                        pieces.append(pairs.reshape(n, 2, -1))
                if first == 0:
                    collected.append([])
                collected[number].append(np.concatenate(pieces, axis=1))
        return [_Candidates.of(np.concatenate(parts)) for parts in collected]

    def _gains_of(self, candidates: list[_Candidates], model: ModalFit) -> FloatArray:
        regression = self.regression
        blocks = regression.blocks(model.omegas, model.zetas, model.clock, gradients=False)
        total = np.zeros(len(candidates[0].gram))
        for number, (block, candidate) in enumerate(zip(blocks, candidates, strict=True)):
            scale = np.linalg.norm(block.matrix, axis=0)
            basis, triangle = np.linalg.qr(block.matrix / np.where(scale > 0.0, scale, 1.0))
            basis = basis[:, np.abs(np.diag(triangle)) > 1e-9]
            shape = candidate.gram.shape[:2]
            inside = (candidate.rows @ basis).reshape(*shape, -1)
            gram = candidate.gram - inside @ inside.transpose(0, 2, 1)
            for output, own in enumerate(regression.block_of):
                if own != number:
                    continue
                values = regression.values[output]
                residual = values - basis @ (basis.T @ values)
                projected = (candidate.rows @ residual).reshape(shape)
                explained = np.einsum(
                    "ga,ga->g", projected, np.linalg.solve(gram, projected[:, :, None])[:, :, 0]
                )
                share = np.clip(explained / max(float(residual @ residual), 1e-300), 0.0, 1.0 - 1e-15)
                total -= 0.5 * len(values) * np.log1p(-share)
        return total


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
    return InputSignal(drive.name, drive.unit, (first, step), values, "cubic")  # type: ignore[arg-type]


def _thinned_record(record: TimeRecord, drive: InputSignal, seed: int) -> TimeRecord:
    """Return a record with another input and not too many stamps."""
    rng = np.random.default_rng(seed)
    outputs = []
    chosen: dict[bytes, IndexArray] = {}
    for output in record.outputs:
        key = output.times_s.tobytes()
        if key not in chosen:
            n = len(output.times_s)
            chosen[key] = (
                np.arange(n) if n <= _MAX_STAMPS else np.sort(rng.choice(n, _MAX_STAMPS, replace=False))
            )
        keep = chosen[key]
        if np.count_nonzero(output.is_valid[keep]) < 20:
            keep = np.flatnonzero(output.is_valid)[:_MAX_STAMPS]
        outputs.append(
            OutputSignal(
                output.name,
                output.unit,
                output.times_s[keep],
                output.values[keep],
                output.exposure_s,
                output.sigma,
            )
        )
    return TimeRecord((drive,), tuple(outputs), record.start_ns, record.name)
