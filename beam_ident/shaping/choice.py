"""The choice for a person: the shortest move that leaves more than the aim with less than 5 % probability."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.errors import ExcitationError
from beam_ident.shaping.command import Move, s_curve
from beam_ident.shaping.known_beam import DRAWS, AxisErrors, KnownBeam
from beam_ident.shaping.residual import ALLOWED, Residual, expected_disturbance, predict_residual
from beam_ident.shaping.shapers import SHAPERS, notched, shaped, smoothed, stretched
from beam_ident.shaping.time_optimal import TIME_OPTIMAL, MoveTask, lower_bound, shortest, time_optimal_move

UNSHAPED = "S-curve"
TEXTBOOK_DAMPING = (0.1, 0.005)
"""Damping ratios that are assumed where nobody has measured one: Klipper's default, and steel's."""
_SLOWEST = 8.0
"""A base move is slowed to at most so many times its shortest length before a shaper counts as failing."""
_HALVINGS = 6
_MAX_LENGTHENING = 3.0
_ROUNDS = 3
_SPREAD_HALVINGS = 8


@dataclass(frozen=True, eq=False)
class JudgedMove:
    """A move and what it does.

    Attributes
    ----------
    move : Move
    residual : Residual
    probability : float -- that the aim is exceeded
    objection : str -- which limit it leaves, or nothing
    """

    move: Move
    residual: Residual
    probability: float
    objection: str

    @property
    def is_fine(self) -> bool:
        """Whether it keeps the limits, and the aim with 95 % probability, as far as the draws can tell."""
        known_to = math.sqrt(ALLOWED * (1.0 - ALLOWED) / DRAWS)
        return not self.objection and self.probability + 2.0 * known_to < ALLOWED


@dataclass(frozen=True, eq=False)
class Choice:
    """What was chosen, and what stands beside it.

    Attributes
    ----------
    task : MoveTask
    aim : float -- [m]
    beam : KnownBeam
    chosen : JudgedMove
        The shortest move that keeps the aim; where none does, the one that is least likely to exceed it.
    keeps_aim : bool
    lower_bound_s : float
        No move of a beam that is known exactly could be shorter [s]; 0 where none was found that keeps the aim.
    needed : str -- where the aim is not kept: what would be needed
    shapers : tuple of JudgedMove -- the shortest move behind every shaper, and the time-optimal one
    others : tuple of JudgedMove -- unshaped, as long unshaped, filters, and shapers of textbook values
    """

    task: MoveTask
    aim: float
    beam: KnownBeam
    chosen: JudgedMove
    keeps_aim: bool
    lower_bound_s: float
    needed: str
    shapers: tuple[JudgedMove, ...]
    others: tuple[JudgedMove, ...]


def choose_move(
    task: MoveTask,
    beam: KnownBeam,
    aim: float,
    *,
    textbook: tuple[FloatArray, FloatArray] | None = None,
    progress: Callable[[str, float], None] = lambda phrase, share: None,
) -> Choice:
    """Return the shortest move that exceeds an aim with less than 5 % probability, within all limits.

    Parameters
    ----------
    task : MoveTask
    beam : KnownBeam
    aim : float -- largest swing of any output after the move [m]
    textbook : (omegas [rad/s], zetas), optional
        What a theory says of the modes, for the comparison: its frequencies are taken, and damping from textbooks.
    progress : callable -- called with a phrase and the share done

    Raises
    ------
    ExcitationError
        An aim that is no length, no move within the limits at all, or modes that no shaper can have.
    """
    if not 0.0 < aim <= abs(task.distance):
        raise ExcitationError(
            f"aim is {aim!r} m; expected a length above 0, in metres, and no more than the move of "
            f"{abs(task.distance):g} m: 20 um are 20e-6"
        )
    search = _Search(task, beam, aim)
    trials: list[JudgedMove] = []
    count = len(SHAPERS) + 2
    for number, name in enumerate(SHAPERS):
        progress(f"behind {name}", number / count)
        trials.append(search.behind(name))
    progress(TIME_OPTIMAL, len(SHAPERS) / count)
    quickest = search.time_optimal(trials)
    if quickest is not None:
        trials.append(quickest)
    fine = [trial for trial in trials if trial.is_fine]
    within = [trial for trial in trials if not trial.objection]
    if not within:
        raise ExcitationError(
            f"no move from {task.start:g} to {task.end:g} m keeps the limits: {trials[-1].objection}; give a shorter "
            "way, or more room"
        )
    if fine:
        chosen = min(fine, key=lambda trial: (len(trial.move.accelerations), trial.probability))
        progress("lower bound", (count - 1) / count)
        bound_s = task.period_s * lower_bound(task, beam, aim, len(chosen.move.accelerations))
        needed = ""
    else:
        chosen = min(within, key=lambda trial: float(np.quantile(_largest(trial), 1.0 - ALLOWED)))
        bound_s, needed = 0.0, _needed(chosen, within, beam, aim)
    others = tuple(search.trial(move) for move in _others(task, beam, chosen.move, textbook))
    return Choice(task, aim, beam, chosen, bool(fine), bound_s, needed, tuple(trials), others)


def _largest(trial: JudgedMove) -> FloatArray:
    return np.asarray(np.max(trial.residual.swings, axis=1))


class _Search:
    """Finds the shortest move of a kind that keeps limits and aim."""

    def __init__(self, task: MoveTask, beam: KnownBeam, aim: float) -> None:
        self._task, self._beam, self._aim = task, beam, aim
        self._quickest = s_curve(task.distance, task.limits.axis, task.period_s, quantity=task.quantity)

    def trial(self, move: Move) -> JudgedMove:
        residual = predict_residual(move, self._beam)
        return JudgedMove(move, residual, residual.probability_above(self._aim), self._task.objection(move))

    def behind(self, shaper: str) -> JudgedMove:
        """Return the shortest move behind a shaper for one mode or more, its base slowed as far as needed."""
        model = self._beam.model
        best: JudgedMove | None = None
        for n_modes in range(1, model.n_modes + 1):
            omegas, zetas = model.natural_frequencies[:n_modes], model.damping_ratios[:n_modes]
            found = self._slowed(shaper, omegas, zetas, f"{shaper} for {_modes(n_modes)}")
            if best is None or _rank(found) < _rank(best):
                best = found
        assert best is not None
        return best

    def _slowed(self, shaper: str, omegas: FloatArray, zetas: FloatArray, name: str) -> JudgedMove:
        task, shortest_s = self._task, self._quickest.duration_s

        def at(slower: float) -> JudgedMove:
            base = s_curve(
                task.distance,
                task.limits.axis,
                task.period_s,
                quantity=task.quantity,
                duration_s=slower * shortest_s,
            )
            return self.trial(shaped(base, shaper, omegas, zetas, name))

        quick = at(1.0)
        if quick.is_fine:
            return quick
        # The swing of a slower base falls, in waves: the first of some that is fine, then halved.
        tried, before = [quick], 1.0
        for slower in np.geomspace(1.0, _SLOWEST, 10)[1:].tolist():
            found = at(slower)
            tried.append(found)
            if not found.is_fine:
                before = slower
                continue
            low, high = before, slower
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                better = at(middle)
                low, high, found = (low, middle, better) if better.is_fine else (middle, high, found)
            return found
        return min(tried, key=_rank)

    def time_optimal(self, shapers: list[JudgedMove]) -> JudgedMove | None:
        """Return the shortest robust time-optimal move that is fine; the best one where none is."""
        task = self._task
        fine = [len(trial.move.accelerations) for trial in shapers if trial.is_fine]
        longest = (
            min(fine)
            if fine
            else round(_MAX_LENGTHENING * max(len(t.move.accelerations) for t in shapers[:2]))
        )
        found: dict[int, JudgedMove] = {}
        beside = np.zeros(self._beam.model.n_modes, dtype=np.complex128)

        def find(n_ticks: int) -> Move | None:
            nonlocal beside
            for _ in range(_ROUNDS):
                move = time_optimal_move(task, self._beam, n_ticks, disturbance=beside)
                if move is None:
                    return None
                trial = self.trial(move)
                if n_ticks not in found or _rank(trial) < _rank(found[n_ticks]):
                    found[n_ticks] = trial
                beside, before = expected_disturbance(move, self._beam), beside
                if found[n_ticks].is_fine or not self._matters(beside - before):
                    break
            return found[n_ticks].move if found[n_ticks].is_fine else None

        if find(longest) is None:
            return found.get(longest)
        least = max(2, math.floor(abs(task.distance) / task.limits.axis.speed / task.period_s))
        n_ticks, _ = shortest(find, min(least, longest), longest)
        return found[n_ticks]

    def _matters(self, phasors: ComplexArray) -> bool:
        """Return whether a change of what disturbs the modes is more than a small part of the aim."""
        model = self._beam.model
        swings = np.abs(model.residues) @ (np.abs(phasors) / model.poles.imag)
        return bool(np.max(swings) > 0.05 * self._aim)


def _rank(trial: JudgedMove) -> tuple[bool, bool, float]:
    """Sort fine moves by their length first, then the others by what they leave."""
    if trial.is_fine:
        return False, False, trial.move.duration_s
    return True, bool(trial.objection), float(np.quantile(_largest(trial), 1.0 - ALLOWED))


def _modes(count: int) -> str:
    return "mode 1" if count == 1 else f"modes 1 to {count}"


def _others(
    task: MoveTask, beam: KnownBeam, chosen: Move, textbook: tuple[FloatArray, FloatArray] | None
) -> Iterator[Move]:
    """Yield the moves that stand beside the chosen one."""
    axis, model = task.limits.axis, beam.model
    base = s_curve(task.distance, axis, task.period_s, quantity=task.quantity)
    yield base
    yield stretched(task.distance, axis, chosen, f"{UNSHAPED}, as long")
    yield smoothed(base, float(model.natural_frequencies[0]))
    yield notched(base, float(model.natural_frequencies[0]), float(model.damping_ratios[0]))
    omegas = model.natural_frequencies if textbook is None else textbook[0]
    whose = "" if textbook is None else ", theory's frequency"
    for zeta in TEXTBOOK_DAMPING:
        yield shaped(base, "ZV", omegas[:1], np.array([zeta]), f"ZV{whose}, damping {zeta:g}")


def _needed(best: JudgedMove, within: Sequence[JudgedMove], beam: KnownBeam, aim: float) -> str:
    """Say what keeps all moves from the aim, and what would be needed of beam or axis."""

    def is_kept(by: KnownBeam) -> bool:
        return any(predict_residual(trial.move, by).probability_above(aim) < ALLOWED for trial in within)

    reached = float(np.quantile(_largest(best), 1.0 - ALLOWED))
    sentence = f"with 95 % probability the best move stays below {1e6 * reached:.3g} um"
    if not is_kept(replace(beam.with_spread(0.0), axis=AxisErrors())):
        return f"{sentence}; the limits leave no quieter one: allow more time, or a shorter way"
    if is_kept(replace(beam, axis=AxisErrors())):
        strays = beam.axis.scatter_at(float(np.max(np.abs(best.move.accelerations))))
        if beam.axis.lag == 0.0:
            return f"{sentence}, since the hub strays by {1e6 * strays:.2g} um: needed is an axis that strays less"
        return (
            f"{sentence}, since the hub lags {1e6 * beam.axis.lag:.3g} um by friction and strays by "
            f"{1e6 * strays:.2g} um: needed is an axis with less of both, or an approach from the same side"
        )
    low, high = 0.0, 1.0
    for _ in range(_SPREAD_HALVINGS):
        middle = 0.5 * (low + high)
        known = replace(beam.with_spread(middle), axis=AxisErrors())
        low, high = (middle, high) if is_kept(known) else (low, middle)
    now = float(beam.frequency_sd[0])
    return (
        f"{sentence}; needed is a first frequency known to {100.0 * low * now:.2g} % (now {100.0 * now:.2g} %): "
        "identify again, with a longer record"
    )
