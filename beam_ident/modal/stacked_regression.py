"""Modal columns over rows of any kind, stacked and weighed: lines of frequency records, samples of decays.

Rows that share columns form a basis: the lines of a record, the samples of a decay.  What is fitted with
linear parameters of its own (an output, or a pair of output and input) stacks rows of one basis or of
several, each row with a weight of its own.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import AnyArray, FloatArray
from beam_ident.modal.block_rows import ColumnBlock, ModeSlopes
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ClockState, turned_candidates


@dataclass(frozen=True, eq=False)
class Columns:
    """Real columns of one mode (or the fixed ones) with their derivatives, each (n_rows, n_columns).

    ``by_time`` is the derivative by the instant of measurement, None where no latency is estimated.
    """

    value: FloatArray
    by_log_omega: FloatArray
    by_zeta: FloatArray
    by_time: FloatArray | None = None


class ColumnBasis(ABC):
    """Rows that share columns."""

    @abstractmethod
    def fixed(self, latency: float) -> Columns:
        """Return the columns that no mode touches (derivatives by a mode are not used)."""

    @abstractmethod
    def modal(self, omega: float, zeta: float, latency: float) -> Columns:
        """Return the columns of one mode."""

    def scanned(self, omegas: FloatArray, zetas: FloatArray, latency: float) -> FloatArray:
        """Return the columns of many candidate modes, shape (n_candidates, n_columns, n_rows)."""
        found = [self.modal(float(w), float(z), latency).value for w, z in zip(omegas, zetas, strict=True)]
        return np.stack([value.T for value in found])


@dataclass(frozen=True, eq=False)
class Part:
    """What one record holds of an output: rows of a basis, measured values and weights, each (n_rows,)."""

    basis: int
    values: FloatArray
    weights: FloatArray


class StackedRegression:
    """A modal model over bases as a linear problem with a few nonlinear parameters.

    Parameters
    ----------
    bases : sequence of ColumnBasis
    outputs : sequence of sequence of Part -- linear parameters are common to the parts of an output
    is_noise_known : bool -- whether weights are one over the noise's standard deviation
    is_sequence : bool -- whether rows are samples of a signal, in the order of time
    n_forced : int -- columns of a mode that the input drives
    times : sequence of ndarray -- stamps of every output's rows [s], where they are samples
    """

    max_latency_s = np.inf

    def __init__(
        self,
        bases: Sequence[ColumnBasis],
        outputs: Sequence[Sequence[Part]],
        is_noise_known: bool,
        is_sequence: bool = False,
        n_forced: int = 1,
        times: Sequence[FloatArray] = (),
    ) -> None:
        self.times = times
        self.bases, self.outputs = bases, outputs
        self.is_noise_known, self.is_sequence, self.n_forced = is_noise_known, is_sequence, n_forced
        self.values: list[FloatArray] = [
            np.concatenate([part.weights * part.values for part in own]) for own in outputs
        ]
        # Outputs whose rows and weights are the same share their columns, and what is computed of them.
        self._keys = [tuple((part.basis, part.weights.tobytes()) for part in own) for own in outputs]
        self._find_blocks([b""] * len(outputs))
        self._absent: AnyArray | None = None
        self.turns: tuple[Callable[[FloatArray], FloatArray], ...] = ()
        self.unturned = self
        self.segments: list[list[tuple[int, slice]]] = []  # of every output: basis and its rows
        for own in outputs:
            ends = np.cumsum([len(part.values) for part in own]).tolist()
            rows = [slice(end - len(part.values), end) for part, end in zip(own, ends, strict=True)]
            self.segments.append([(part.basis, here) for part, here in zip(own, rows, strict=True)])
        self.places = [slice(0, len(values)) for values in self.values]
        self.n_shared_fixed: int = bases[0].fixed(0.0).value.shape[1]
        self._width: int = bases[0].modal(1.0, 0.1, 0.0).value.shape[1]

    def _find_blocks(self, of_outputs: Sequence[bytes]) -> None:
        keys = list(zip(self._keys, of_outputs, strict=True))
        distinct = list(dict.fromkeys(keys))
        self.block_of = [distinct.index(key) for key in keys]
        self._blocks = [self.block_of.index(block) for block in range(len(distinct))]

    def without(self, absent: AnyArray) -> StackedRegression:
        """Return the regression in which some modes have no share in some outputs.

        Parameters
        ----------
        absent : ndarray of bool, shape (n_outputs, n_modes)
        """
        result = copy.copy(self)
        result._absent = absent
        result._find_blocks([own.tobytes() for own in absent])
        return result

    def turned(self, turns: Sequence[Callable[[FloatArray], FloatArray]]) -> StackedRegression:
        """Return the regression with rows and values passed through a linear map for every output.

        Parameters
        ----------
        turns : sequence of callable -- from columns of an output, shape (n_rows, n), to as many rows
        """
        result = copy.copy(self)
        result.turns, result.unturned = tuple(turns), self
        result._find_blocks([str(j).encode() for j in range(len(turns))])
        result.values = [turn(own[:, None])[:, 0] for turn, own in zip(turns, self.values, strict=True)]
        return result

    @property
    def pieces(self) -> tuple[StackedRegression, ...]:
        """Itself: lines and decays are few."""
        return (self,)

    @property
    def n_samples(self) -> int:
        """Number of real rows, over all outputs."""
        return sum(len(values) for values in self.values)

    @property
    def n_parameters_of_a_mode(self) -> int:
        """Number of parameters that one more mode adds."""
        return 2 + self._width * len(self.outputs)

    def n_columns(self, n_modes: int) -> int:
        """Number of linear parameters of one output."""
        return self.n_shared_fixed + n_modes * self._width

    def blocks(
        self, omegas: FloatArray, zetas: FloatArray, clock: ClockState, gradients: bool
    ) -> list[ColumnBlock]:
        """Return the columns of every block of outputs: the fixed ones, then those of all modes."""
        del gradients
        n, late = len(omegas), clock.latency
        of_bases = []
        for basis in self.bases:
            modes = [basis.modal(float(w), float(z), late) for w, z in zip(omegas, zetas, strict=True)]
            of_bases.append([basis.fixed(late), *modes])
        # Side by side for each basis: all columns, and the derivatives of those of the modes.
        plain = [np.concatenate([c.value for c in own], axis=1) for own in of_bases]
        nothing = [np.zeros((len(own[0].value), 0)) for own in of_bases]
        by_pole = [
            np.concatenate([none, *(c.by_log_omega for c in own[1:]), *(c.by_zeta for c in own[1:])], axis=1)
            for own, none in zip(of_bases, nothing, strict=True)
        ]
        rates = [[c.by_time for c in own if c.by_time is not None] for own in of_bases]
        is_late = all(len(rate) == 1 + n for rate in rates)
        by_time = [np.concatenate(rate, axis=1) for rate in rates] if is_late else []
        columns = self.n_shared_fixed + np.arange(n * self._width).reshape(n, self._width)
        result = []
        for number in self._blocks:
            output = self.outputs[number]
            n_rows = sum(len(part.values) for part in output)
            slopes = _weighed(output, by_pole).reshape(n_rows, 2, n, self._width)
            matrix = _weighed(output, plain)
            if self._absent is not None:
                matrix[:, columns[self._absent[number]].ravel()] = 0.0
                slopes[:, :, self._absent[number]] = 0.0
            block = ColumnBlock(
                matrix=matrix,
                mode_columns=columns,
                modes=tuple(ModeSlopes(slopes[:, 0, k], slopes[:, 1, k]) for k in range(n)),
                by_time=_weighed(output, by_time) if is_late else None,
                latency_factor=np.full(n_rows, -1.0),  # later stamps, earlier instants
                rate_factor=np.zeros(n_rows),
            )
            result.append(block.turned(self.turns[number]) if self.turns else block)
        return result

    def candidates(self, omegas: FloatArray, zetas: FloatArray, clock: ClockState) -> list[FloatArray]:
        """Return the columns of single modes in every block, each (n_candidates, n_columns of a mode, n_rows)."""
        found = [basis.scanned(omegas, zetas, clock.latency) for basis in self.bases]
        plain = [
            np.concatenate([found[part.basis] * part.weights for part in self.outputs[number]], axis=2)
            for number in self._blocks
        ]
        if not self.turns:
            return plain
        return [
            turned_candidates(own, self.turns[number])
            for number, own in zip(self._blocks, plain, strict=True)
        ]

    def modelled(self, fit: ModalFit) -> list[FloatArray]:
        """Return what the model says on the rows of every basis, without weights, each (n_rows, n_outputs)."""
        result = []
        for basis in self.bases:
            poles = zip(fit.omegas, fit.zetas, strict=True)
            modes = [basis.modal(float(w), float(z), fit.clock.latency).value for w, z in poles]
            columns = np.concatenate([basis.fixed(fit.clock.latency).value, *modes], axis=1)
            result.append(columns @ np.array(fit.coefficients).T)
        return result


def _weighed(output: Sequence[Part], of_bases: Sequence[FloatArray]) -> FloatArray:
    """Return weighed rows of an output from arrays given for every basis."""
    return np.concatenate([part.weights[:, None] * of_bases[part.basis] for part in output])
