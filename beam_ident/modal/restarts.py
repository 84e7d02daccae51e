"""Where the modes begin anew in the middle of a record: after a gap of the input that nobody can bridge well enough.

What the hub did in a gap ends as a state of every mode, and as a wrong constant where the input is integrated.  The
free motion that begins where the input is known again stands for it, whatever it was: the record stays one record,
on one clock, with one offset and one drift.  That costs parameters, so that it is done only where the bridge
(``data.gaps``) is not good enough; everything between the first and the last sample of such a gap is left out.
An input that is integrated forgets nothing: its constants of integration begin anew after every gap, the modes, which
forget, only where the bridge is poor for them too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.gaps import POOR_BRIDGE, InputGap
from beam_ident.data.records import InputSignal
from beam_ident.modal.structure import ModalStructure
from beam_ident.numerics.free_motion import free_motions

_SAME_LATENCY_S = 1e-4
_SAME_SHARE = 0.005  # of the shortest gap, where gaps are short


@dataclass(frozen=True)
class Restarts:
    """The gaps after which something begins anew.

    Attributes
    ----------
    gaps : tuple of tuple of InputGap -- of every record
    n_drifts : int -- constants of integration that a gap leaves unknown: position, and speed
    rigid : tuple of frozenset of InputGap -- those of every record after which these constants alone begin anew
    latency : float -- of the outputs' stamps, by which samples inside a gap are found [s]
    """

    gaps: tuple[tuple[InputGap, ...], ...]
    n_drifts: int
    rigid: tuple[frozenset[InputGap], ...]
    latency: float = 0.0

    @staticmethod
    def at_poor_bridges(
        inputs: Sequence[Sequence[InputSignal]], structure: ModalStructure, latency: float = 0.0
    ) -> Restarts:
        """Return the gaps whose bridge is poor by the input alone: of one that is integrated, all.

        Parameters
        ----------
        inputs : sequence of sequence of InputSignal -- of every record
        structure : ModalStructure
        latency : float -- of the outputs' stamps [s]

        Notes
        -----
        The modes go on after gaps of an integrated input that hold, all together, less of its energy than a poor
        bridge would. Where several inputs drive the modes, whatever may be missing of any of them makes the modes
        begin anew.
        """
        n_drifts = _n_drifts(structure)
        gaps, rigid = [], []
        for drives in inputs:
            is_alone = len(drives) == 1
            every = [(drive, gap) for drive in drives for gap in drive.gaps]
            if is_alone and not n_drifts:
                every = [
                    (drive, gap)
                    for drive, gap in every
                    if not gap.sigma < POOR_BRIDGE * float(np.std(drive.values))
                ]
            own = tuple(gap for _, gap in every)
            gaps.append(own if is_alone else _apart(own))
            rigid.append(_hardly_missed(drives[0]) if is_alone and n_drifts else frozenset())
        return Restarts(tuple(gaps), n_drifts, tuple(rigid), latency)

    def is_near(self, other: Restarts) -> bool:
        """Whether another one has the same gaps, and a latency that finds the same samples inside them."""
        if (self.gaps, self.rigid) != (other.gaps, other.rigid):
            return False
        shortest = min((gap.end_s - gap.start_s for own in self.gaps for gap in own), default=np.inf)
        near = min(_SAME_LATENCY_S, _SAME_SHARE * shortest)
        return self.count == 0 or abs(self.latency - other.latency) < near

    @property
    def count(self) -> int:
        """How many there are, in all records."""
        return sum(len(own) for own in self.gaps)

    def of_record(self, index: int) -> tuple[tuple[InputGap, bool], ...]:
        """Return every gap of a record after which something begins anew, and whether the modes do."""
        rigid = self.rigid[index]
        return tuple((gap, gap not in rigid) for gap in self.gaps[index])

    def n_columns(self, n_modes: int, index: int) -> int:
        """Return how many columns begin after the gaps of a record."""
        own = self.of_record(index)
        return self.n_drifts * len(own) + 2 * n_modes * sum(is_modal for _, is_modal in own)


@dataclass(frozen=True, eq=False)
class RestartColumns:
    """Columns of one restart at one grid of stamps.

    Attributes
    ----------
    drifts : sequence of (value, by time) -- of the integrated input, each (n,)
    free : tuple of ndarray -- free motions and their derivatives, each (n_modes, n)
    """

    drifts: Sequence[tuple[FloatArray, FloatArray]]
    free: tuple[ComplexArray, ...]


def _apart(gaps: Sequence[InputGap]) -> tuple[InputGap, ...]:
    """Return the gaps of several inputs in order of time, those that overlap as one."""
    result: list[InputGap] = []
    for gap in sorted(gaps, key=lambda own: own.start_s):
        if result and gap.start_s < result[-1].end_s:
            result[-1] = replace(
                result[-1],
                end_s=max(result[-1].end_s, gap.end_s),
                missing=result[-1].missing + gap.missing,
                sigma=max(result[-1].sigma, gap.sigma),
            )
        else:
            result.append(gap)
    return tuple(result)


def _hardly_missed(drive: InputSignal) -> frozenset[InputGap]:
    """Return gaps of an input that hold, all together, less of its energy than a poor bridge would."""
    lost = sorted((gap.sigma**2 * (gap.end_s - gap.start_s), gap.start_s, gap) for gap in drive.gaps)
    span_s = float(drive.times_s[-1] - drive.times_s[0])
    least = POOR_BRIDGE**2 * float(np.var(drive.values)) * span_s
    sums = np.cumsum([own for own, _, _ in lost])
    return frozenset(gap for (_, _, gap), total in zip(lost, sums, strict=True) if total < least)


def _n_drifts(structure: ModalStructure) -> int:
    return 2 - structure.differentiations if structure.has_direct else 0


def restart_columns(
    n_drifts: int,
    poles: ComplexArray,
    instants: FloatArray,
    exposure_s: float,
    gap: InputGap,
    pole_slopes: tuple[ComplexArray, ...],
) -> RestartColumns:
    """Return what begins after a gap, zero before.

    Parameters
    ----------
    n_drifts : int -- 0, 1 or 2: none, a constant, a constant and a ramp
    poles : ndarray, shape (n_modes, 1) -- [rad/s]
    instants : ndarray, shape (n,) -- when the samples were taken, on the input's clock [s]
    exposure_s : float
    gap : InputGap
    pole_slopes : tuple of ndarray -- as of ``free_motions``

    Notes
    -----
    A sample stands after a gap where it stands after its middle: those inside are left out, and no sample changes
    sides while the fit moves the latency by less than that.
    """
    after = instants > gap.middle_s
    elapsed = np.where(after, instants - gap.end_s, 0.0)
    one = after.astype(np.float64)
    drifts = [(one, np.zeros_like(one)), (elapsed, one)][:n_drifts]
    found = []
    for motions in free_motions(poles, elapsed[after], exposure_s, pole_slopes):
        column = np.zeros((len(poles), len(instants)), dtype=np.complex128)
        column[:, after] = motions
        found.append(column)
    return RestartColumns(drifts, tuple(found))


def bridge_amplitudes(
    gap: InputGap, structure: ModalStructure, omegas: FloatArray, zetas: FloatArray
) -> tuple[ComplexArray, FloatArray]:
    """Return what errors of a bridge leave behind it.

    Parameters
    ----------
    gap : InputGap -- with errors of its size
    structure : ModalStructure
    omegas, zetas : ndarray, shape (n_modes,) -- [rad/s], [-]

    Returns
    -------
    modal : ndarray, shape (n_trials, n_modes)
        The free motion of every mode is ``Im(modal exp(p (t - end)))`` for a residue of one.
    drifts : ndarray, shape (n_trials, n_drifts) -- position, and speed, for a direct gain of one

    Notes
    -----
    An error e(s) over the gap, which ends at b, leaves of (I.5)

        Im( p^k / Im p  int e(s) exp(p (b - s)) ds  exp(p (t - b)) )
    """
    step = (gap.end_s - gap.start_s) / (gap.missing + 1)
    left = gap.end_s - _places(gap)
    poles = omegas * (-zetas + 1j * np.sqrt(1.0 - zetas**2))
    motions = gap.errors @ np.exp(left[:, None] * poles) * step
    modal = structure.sign * motions * poles**structure.differentiations / poles.imag
    speed, slip = gap.errors.sum(axis=1) * step, gap.errors @ left * step
    drifts = [np.empty((len(speed), 0)), speed[:, None], np.stack([slip, speed], axis=1)]
    return modal, drifts[_n_drifts(structure)]


def _places(gap: InputGap) -> FloatArray:
    """Return the stamps of the missing samples [s]."""
    return np.asarray(np.linspace(gap.start_s, gap.end_s, gap.missing + 2)[1:-1])


def bridge_effects(
    gap: InputGap,
    structure: ModalStructure,
    omegas: FloatArray,
    zetas: FloatArray,
    shared: FloatArray,
    instants: FloatArray,
    with_direct: bool = True,
) -> FloatArray:
    """Return what errors of a bridge do to one output, shape (n_trials, n).

    Parameters
    ----------
    gap, structure, omegas, zetas -- as of ``bridge_amplitudes``
    shared : ndarray, shape (n_shared,) -- direct gain, residual term and residues of the output
    instants : ndarray, shape (n,) -- when its samples were taken, on the input's clock [s]
    with_direct : bool -- False: of the modes alone, where constants of integration begin anew
    """
    modal, drifts = bridge_amplitudes(gap, structure, omegas, zetas)
    after, inside = instants >= gap.end_s, (instants > gap.start_s) & (instants < gap.end_s)
    elapsed = instants[after] - gap.end_s
    effects = np.zeros((len(modal), len(instants)))
    residues = shared[len(shared) - len(omegas) :]
    for omega, zeta, amplitudes in zip(omegas, zetas, (modal * residues).T, strict=True):
        pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        effects[:, after] += np.imag(amplitudes[:, None] * np.exp(pole * elapsed))
    if structure.has_direct and with_direct:
        gain = float(shared[0])
        direct = gap.errors if not drifts.shape[1] else np.repeat(drifts[:, :1], gap.missing, axis=1)
        effects[:, inside] += gain * np.stack(
            [np.interp(instants[inside], _places(gap), own) for own in direct]
        )
        for order, own in enumerate(drifts.T):
            effects[:, after] += gain * own[:, None] * elapsed**order
    return effects
