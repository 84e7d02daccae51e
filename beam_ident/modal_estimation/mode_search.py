"""The search for modes, without hints: one loop for time records, lines and decays.

Modes are added one at a time: a scan proposes where, the fit refines all of them together, and the Bayesian
information criterion decides whether the new one is worth its parameters.  A mode must also pass the gates
(``mode_gates``), and pass them again once the data are weighed by the noise as it is.

While modes are missing, what they leave over disturbs the fit of those that are there: it converges slowly, or takes
a place between two of them.  So the search goes on for a few orders past a fit that is not believed, as long as
the criterion falls; what is chosen in the end has passed every gate.

What differs between kinds of data stands in the few methods that a kind overrides: where a scan looks, what a
clock may have slipped, and how the noise weighs.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.argument_checks import require_whole_number
from beam_ident.data.bandwidth import Band
from beam_ident.data.batches import Progress
from beam_ident.data.prior import Prior
from beam_ident.errors import EstimationError
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.identification_result import OrderEntry
from beam_ident.modal.regression import ClockState
from beam_ident.modal_estimation.mode_gates import crowd, mode_complaint, mode_significance
from beam_ident.modal_estimation.mode_scan import Candidate
from beam_ident.modal_estimation.variable_projection import SINGULAR, ModalProblem, fit_modes
from beam_ident.noise.scores import Scores
from beam_ident.numerics.levenberg_marquardt import HOPELESS

MAX_MODES = 15  # thirty poles
_MAX_ORDER = 40

# Rows for each unknown of an output; a level of the noise that is to be estimated too takes twice as many.
_ROWS_PER_UNKNOWN = 2
# Without a complaint, a mode is given up for a fit that settles only where it is near another and explains little.
_BESIDE = 0.05  # of the frequency
_HARDLY_MORE = 1.1  # residuals without it over those with it
_ITERATIONS = 40
SHORT = 8  # iterations of a fit on the way
_RIVAL_ITERATIONS = 6
# From here on most are spurious: a given order is reached by short fits, the last one in full.
MANY_MODES = 12
_TRIES_PER_ORDER = 2
_GLANCE = 3  # iterations between two modes that are only placed
_MOST_LEFT_OUT = 3  # modes: where more of them are doubtful, the start was a poor one
_CLOCKS = 2  # far from that which a search ended with, from which it is begun again
_PATIENCE = 6  # orders past the last that was believed
_SAME = 1e-3  # in log-likelihood: what two ways to one optimum may differ by
SLOW_NOISE = "slow noise of the outputs"
_SHORT_PATIENCE = 2  # the same where every fit converges: a disturbance may stand before a mode

# What may end a search or a fit before its time without the loss of what it has found: a key pressed, or a signal;
# too little memory; a progress that lets no more time.
Stopped = (KeyboardInterrupt, MemoryError, TimeoutError)

ProblemT = TypeVar("ProblemT", bound=ModalProblem)


def silent(phrase: str, share: float) -> None:
    """Report no progress."""
    del phrase, share


def why_stopped(stop: BaseException, missing: str) -> str:
    """Return what ended an estimation before its time, and what is missing therefore."""
    causes = {KeyboardInterrupt: "interrupted", MemoryError: "the memory did not suffice"}
    cause = next((said for kind, said in causes.items() if isinstance(stop, kind)), "the time was up")
    return f"{cause}; missing is {missing}"


def checked_limit(n_modes: int | None, max_modes: int) -> int:
    """Return how many modes are looked for at most, or raise EstimationError for an impossible number."""
    if n_modes is not None:
        require_whole_number("n_modes", n_modes, 1, _MAX_ORDER)
    require_whole_number("max_modes", max_modes, 1, _MAX_ORDER)
    return max_modes if n_modes is None else n_modes


@dataclass(frozen=True, eq=False)
class Weighed(Generic[ProblemT]):
    """A fit weighed by the noise as it is, the problem that it belongs to, and that with weights for records.

    ``stopped_by`` is what ended the estimation before its time, if anything did.
    """

    fit: ModalFit
    problem: ProblemT
    by_record: ProblemT
    stopped_by: BaseException | None = None

    def unfinished(self, stop: BaseException, missing: str) -> Weighed[ProblemT]:
        """Return a fit that says what ended the estimation before its time, and what is missing therefore."""
        fit = dataclasses.replace(self.fit, converged=False, reason=why_stopped(stop, missing))
        return dataclasses.replace(self, fit=fit, stopped_by=stop)


@dataclass(frozen=True, eq=False)
class Tried:
    """A fit that was tried, and its place in the table of orders."""

    fit: ModalFit
    entry: int


@dataclass
class Looks:
    """What a search looks for beyond the next mode; of a search that is done, what has led to a better end.

    Attributes
    ----------
    past_doubt : bool -- orders past one that is not believed
    inside : bool -- where simpler structures end
    """

    past_doubt: bool
    inside: bool


class ModeSearch(ABC, Generic[ProblemT]):
    """The search over orders, and the best fit found so far.

    Parameters
    ----------
    problem : ModalProblem
    band : Band -- where modes are looked for
    latency, clock_rate : Prior
    shows_clock : bool -- whether the columns that no mode touches tell anything of the clock
    progress : callable
    start : ModalFit or None -- modes that are there already; None begins without any
    """

    remedy = "Excite more, record longer"  # for data that show no mode
    trial_iterations = _ITERATIONS  # while the order is free
    weighed_by = ""  # what rows weigh by that are not as measured

    def __init__(
        self,
        problem: ProblemT,
        band: Band,
        latency: Prior,
        clock_rate: Prior,
        shows_clock: bool,
        progress: Progress = silent,
        start: ModalFit | None = None,
    ) -> None:
        self.plain = self.problem = problem
        self.band = band
        self.priors, self.shows_clock = (latency, clock_rate), shows_clock
        self.progress = progress
        self.max_iterations = _ITERATIONS
        if start is None:
            base = self.fit(np.empty(0), np.empty(0), self._clock_meant)
        else:
            base = self.fit(start.omegas, start.zetas, start.clock)
        self.without_modes = base
        self.entries: list[OrderEntry] = [self._entry(base, "")]
        self._present = self._believed = Tried(base, 0)  # the last that passed every gate is believed
        self._is_unsettled = False  # whether a fit that did not converge promised more since
        self.looks, self.paid = Looks(True, True), Looks(False, False)
        self.is_behind_noise = False  # whether rows are whitened by the outputs' slow noise
        self.is_curved = False  # whether poles crowd where one that goes with the amplitude may stand

    @property
    def latency(self) -> Prior:
        """What is known of the outputs' latency."""
        return self.priors[0]

    @property
    def clock_rate(self) -> Prior:
        """What is known of the rate of the outputs' clock."""
        return self.priors[1]

    @property
    def chosen(self) -> ModalFit:
        """The present fit."""
        return self._present.fit

    @abstractmethod
    def propose(self, fit: ModalFit, excluded: Sequence[float]) -> list[Candidate]:
        """Return where a further mode may stand; rivals, if several; none when the band is used up.

        Parameters
        ----------
        fit : ModalFit -- the present model
        excluded : sequence of float -- frequencies [rad/s] whose neighbourhood has been tried in vain
        """

    def untangled(self, fit: ModalFit) -> ModalFit:
        """Return the fit after a look for cycles that the clock may have slipped."""
        return fit

    def retimed(self, fit: ModalFit) -> list[ModalFit]:
        """Return the modes of a fit at clocks far from its own that explain more."""
        del fit
        return []

    def is_promising(self, fit: ModalFit) -> bool:
        """Return whether a fit that is not believed may lead to one that is."""
        del fit
        return True

    def reweigh(self) -> None:
        """Let what the present model leaves decide how the data weigh against each other."""

    def looks_behind_noise(self) -> bool:
        """Return whether the outputs' slow noise is so loud that it may hide modes from rows that weigh alike."""
        return False

    def _refit(self) -> None:
        """Fit the present model anew to rows that weigh otherwise."""
        before = self._present
        again = self.fit(before.fit.omegas, before.fit.zetas, before.fit.clock)
        self._present = Tried(again, before.entry)
        if self._believed is before:
            self._believed = self._present

    def doubt(self) -> None:
        """Look for what may be wrong with the data, once a mode that explains much is not believed."""

    def weighed(self, fit: ModalFit) -> Weighed[ProblemT]:
        """Return a fit of the search, weighed by the noise as it is."""
        return Weighed(fit, self.plain, self.plain)

    def _stopped(self, stop: BaseException, missing: str) -> Weighed[ProblemT]:
        """Return the best fit so far, or raise what stopped the search where there is none with a mode."""
        if len(self._believed.fit.omegas):
            self._present = self._believed
        if not len(self.chosen.omegas):
            raise stop
        return self.ended_early(self.chosen, stop, missing)

    def ended_early(self, fit: ModalFit, stop: BaseException, missing: str) -> Weighed[ProblemT]:
        """Return a fit with equal weights as the best there is."""
        return Weighed(fit, self.plain, self.plain).unfinished(stop, missing)

    def fit(
        self,
        omegas: FloatArray,
        zetas: FloatArray,
        clock: ClockState,
        max_iterations: int | None = None,
        target: float = math.inf,
    ) -> ModalFit:
        """Return the fit from a start, of the problem as it weighs at present."""
        latency, rate = self.priors
        if not len(omegas) and not self.shows_clock:
            latency, rate = Prior(latency.mean), Prior(rate.mean)
        iterations = self.max_iterations if max_iterations is None else max_iterations
        return fit_modes(self.problem, omegas, zetas, clock, latency, rate, iterations, target)

    def run(self, n_modes: int | None, max_modes: int, is_weighed: bool = True) -> Weighed[ProblemT]:
        """Add modes until the given number is reached, or until one is not believed; weigh what was found.

        Parameters
        ----------
        n_modes : int or None -- how many; None lets the criterion decide
        max_modes : int -- bound on the search
        is_weighed : bool -- False returns what was found with equal weights

        Raises
        ------
        EstimationError
            No mode stands out of the noise, before it weighs or behind it.
        """
        limit, ended = max_modes if n_modes is None else n_modes, ""
        wanted = f"up to {limit} modes" if n_modes is None else f"{limit} modes"
        missing = "the search for more than {n} of " + wanted + ", and the weighing by the noise"
        try:
            ended = self._extend_anew(n_modes, limit, self._extend(n_modes, limit))
            missing = "a second look at orders that were not believed, and the weighing by the noise"
            ended = self._look_past_doubt(limit, ended) if n_modes is None else ended
            missing = "a look behind the outputs' slow noise, and the weighing by the noise as it is"
            self._extend_behind_noise(n_modes, limit)
            missing = "a look at what simpler structures find, and the weighing by the noise"
            if n_modes is not None and self.looks.inside:
                end = self.inside(len(self.chosen.omegas))
                self.paid.inside = end is not None and self.go_on_from(end)
        except Stopped as stop:
            return self._stopped(stop, missing.format(n=len(self.chosen.omegas)))
        if not len(self.chosen.omegas):
            if (alone := self.body_alone()) is None:
                raise self._nothing_found(self.entries[-1].refused_because or ended)
            self._present = Tried(alone, self._present.entry)
        if not is_weighed:
            return Weighed(self.chosen, self.problem, self.problem)
        return self._weighed(n_modes)

    def _weighed(self, n_modes: int | None) -> Weighed[ProblemT]:
        """Return what was found, weighed by the noise; of a free number, without modes that this refutes."""
        try:
            self.progress("weighing by the noise as it is", 0.97)
            weighed = self.weighed(self.chosen)
        except Stopped as stop:
            return self.ended_early(self.chosen, stop, "the weighing by the noise as it is")
        if n_modes is not None:
            return weighed
        try:
            weighed = self._confirmed(weighed)
        except Stopped as stop:
            return weighed.unfinished(
                stop, "a second look at modes that only the input's noise may have feigned"
            )
        doubts = self._doubts_of(weighed)
        if doubts and len(doubts) == len(weighed.fit.omegas):
            raise self._nothing_found(f"weighed by it as it is, {doubts[0]}")
        return weighed

    def _look_past_doubt(self, limit: int, ended: str) -> str:
        """Go back from orders that were not believed to one that is, and return why no further one was tried."""
        if self._present is self._believed and not self._is_unsettled:
            return ended
        if not self.looks.past_doubt:
            return ended
        if not self.is_curved and self._settle(limit):
            self.paid.past_doubt = True
            ended = self._extend(None, limit)
        self._present = self._believed
        return ended

    def _nothing_found(self, reason: str) -> EstimationError:
        return EstimationError(
            f"no mode between {self.band.low_hz:.3g} and {self.band.high_hz:.3g} Hz stands out of the "
            f"noise ({reason}). {self.remedy}, or ask for a number of modes to see the best candidate"
        )

    def _extend_anew(self, n_modes: int | None, limit: int, ended: str) -> str:
        """Search again from a clock far from the present one where that promises more, and keep the better end.

        A clock that is cycles away bends poles until they fit it: no mode promises more elsewhere by itself.
        """
        for _ in range(_CLOCKS):
            ends = list(dict.fromkeys([self.chosen, self._believed.fit]))
            found = [fit for own in ends for fit in self.retimed(own)]
            if not found:
                break
            # Of many modes in doubt, those that are left hardly say which clock was the better one: it is tried, too.
            best = min(found, key=self._bic)
            starts = [min(map(self._without_doubtful, found), key=self._bic), self._without_doubtful(best)]
            better = [
                following
                for start in starts[: 1 if _is_same(*starts) else 2]
                # Nothing else would be found from where a search has ended.
                if not any(_is_same(start, own) for own in ends)
                and (following := self._extend_from(start, n_modes, limit))
            ]
            if not better:
                break
            ended = better[-1]
        return ended

    def _extend_from(self, start: ModalFit, n_modes: int | None, limit: int) -> str:
        """Search from other modes, and return why it ended; or nothing, and go back, where that end is no better."""
        before = self._present, self._believed, self.entries, self._is_unsettled
        self.entries, self._is_unsettled = [self.entries[0], self._entry(start, "")], False
        self._present = self._believed = Tried(start, 1)
        ended = self._extend(n_modes, limit)
        if self._bic(self.chosen) < self._bic(before[0].fit):
            return ended
        self._present, self._believed, self.entries, self._is_unsettled = before
        return ""

    def _extend_behind_noise(self, n_modes: int | None, limit: int) -> None:
        """Search on in rows in which slow noise is white; of a given number, in place of the modes in doubt.

        Noise of a colour is white noise and more: where it is less likely than that, it is none.
        """
        n_doubtful = 0 if n_modes is None else len(self._doubtful(self.chosen))
        if n_modes is not None and not n_doubtful:
            return
        before, problem, past_doubt = (self._present, self._believed), self.problem, self.looks.past_doubt
        self.looks.past_doubt = False
        if n_modes is not None:
            self._present = Tried(self._without_doubtful(self.chosen), self._present.entry)
        self.is_behind_noise = self.looks_behind_noise()
        if self.is_behind_noise:
            self._believed = self._present
            self._extend(n_modes, limit)
            self.is_behind_noise = n_modes is None or (
                self.chosen.converged
                and len(self._doubtful(self.chosen)) < n_doubtful
                and self.chosen.cost < before[0].fit.cost
            )
        if not self.is_behind_noise:
            self.problem, (self._present, self._believed) = problem, before
        self.looks.past_doubt = past_doubt

    def _without_doubtful(self, fit: ModalFit) -> ModalFit:
        """Return a fit without the modes that do not pass the gates, as long as one is left.

        Where none passes, one that has left the band may have taken from the others what makes them stand out.
        """
        while len(fit.omegas) > 1:
            doubtful = self._doubtful(fit)
            if len(doubtful) == len(fit.omegas):
                doubtful = self._outside(fit)
            if not doubtful or len(doubtful) == len(fit.omegas):
                break
            fit = self.fit(np.delete(fit.omegas, doubtful), np.delete(fit.zetas, doubtful), fit.clock)
        return fit

    def body_alone(self) -> ModalFit | None:
        """Return a fit without modes that says something all the same, of a rigid body; None where there is none."""
        return None

    def inside(self, n_modes: int) -> ModalFit | None:
        """Return where as many modes end by way of structures inside this one; None where the fit is not in doubt."""
        del n_modes
        return None

    def go_on_from(self, inside: ModalFit) -> bool:
        """Go on from where modes ended otherwise, and return whether that is better than where this search ended.

        A structure that holds another can do all that it does, and must not end worse: not even where fewer of its
        modes are in doubt, since it has more that can take their place.
        """
        if len(inside.omegas) != len(self.chosen.omegas):
            return False
        fit = self.fit(inside.omegas, inside.zetas, inside.clock, _ITERATIONS)
        if not fit.cost < self.chosen.cost:
            return False
        self._present = self._believed = self._listed(fit, self._refusal(fit, fit, is_given=True))
        return True

    def _listed(self, fit: ModalFit, refusal: str) -> Tried:
        """Put a fit into the table of orders."""
        self.entries.append(self._entry(fit, refusal))
        return Tried(fit, len(self.entries) - 1)

    def _outside(self, fit: ModalFit) -> list[int]:
        """Return the modes of a fit that have left the band."""
        hertz = fit.omegas / (2.0 * np.pi)
        left = np.flatnonzero((hertz < self.band.low_hz) | (hertz > self.band.high_hz))
        return [int(mode) for mode in left]

    def _doubtful(self, fit: ModalFit) -> list[int]:
        """Return the modes of a fit that do not pass the gates."""
        modes = range(len(fit.omegas))
        return [mode for mode in modes if mode_complaint(fit, self.problem, mode, self.band)]

    def _extend(self, n_modes: int | None, limit: int) -> str:
        """Add modes to the present model, and return why no further one was tried."""
        thorough = self.trial_iterations if n_modes is None else _ITERATIONS
        while (n := len(self.chosen.omegas)) < limit:
            self.reweigh()
            is_on_the_way = n_modes is not None and MANY_MODES <= n < limit - 1
            self.max_iterations = SHORT if is_on_the_way else thorough
            if n_modes is None and not self._affords(n + 1):
                return "too few data for its parameters"
            if not self._adds_mode(n_modes, limit):
                break
        return "no candidate"

    @property
    def orders(self) -> tuple[OrderEntry, ...]:
        """The table of orders, with the choice marked."""
        return tuple(
            dataclasses.replace(entry, is_chosen=index == self._present.entry)
            for index, entry in enumerate(self.entries)
        )

    def _adds_mode(self, n_modes: int | None, limit: int) -> bool:
        """Try to add a mode to the present model, and return whether one was taken."""
        current, n = self._present, len(self.chosen.omegas)
        excluded: list[float] = []
        doubted: list[Tried] = []
        for attempt in range(_TRIES_PER_ORDER if n_modes is None else 1):
            share = min(0.95, (n + 0.5 * attempt) / (limit if n_modes is not None else 5))
            self.progress(f"looking for mode {n + 1}", share)
            candidates = self.propose(current.fit, excluded)
            if not candidates:
                break
            candidate, trial = self._fitted_with_one_of(candidates, current.fit, n_modes)
            excluded.append(candidate.omega)
            refusal = self._refusal(trial, current.fit, n_modes is not None)
            is_better = trial.reason != HOPELESS and self._bic(trial) < self._bic(current.fit)
            if refusal and is_better and not trial.converged:
                self.doubt()
            tried = self._listed(trial, refusal)
            if not refusal or n_modes is not None:
                self.paid.past_doubt |= current is not self._believed
                self._present = self._believed = tried
                self._is_unsettled = False
                return True
            if is_better:
                if current is self._believed and n and crowd(trial, self.problem, self.band):
                    self.is_curved = True
                self._is_unsettled |= not trial.converged
                if trial.information_condition < SINGULAR:
                    doubted.append(tried)
        patience = _PATIENCE if self._is_unsettled else _SHORT_PATIENCE
        goes_on = self.looks.past_doubt and not self.is_curved
        if not goes_on or not doubted or n + 1 > len(self._believed.fit.omegas) + patience:
            return False
        self._present = min(doubted, key=lambda own: own.fit.cost)
        return True

    def _fitted_with_one_of(
        self, candidates: Sequence[Candidate], current: ModalFit, n_modes: int | None
    ) -> tuple[Candidate, ModalFit]:
        """Return the candidate that a few iterations prefer, and the fit with it.

        What the outputs share with the input before there is a mode may say little of the clock: then that which is
        meant is tried as well.
        """
        clocks = [current.clock]
        if not len(current.omegas):
            clocks = list(dict.fromkeys([current.clock, self._clock_meant]))
        starts = [
            (own, (np.append(current.omegas, own.omega), np.append(current.zetas, own.zeta), clock))
            for clock in clocks
            for own in candidates
        ]
        place = 0
        if len(starts) > 1:
            rivals = [self.fit(*start, _RIVAL_ITERATIONS) for _, start in starts]
            place = int(np.argmin([rival.cost for rival in rivals]))
        candidate, start = starts[place]
        trial = self.fit(*start, target=self._target(current, n_modes))
        return candidate, trial if trial.reason == HOPELESS else self.untangled(trial)

    def _settle(self, limit: int) -> bool:
        """Go back from orders that are not believed to one that is; False where that is the last that was believed.

        Where fits did not converge, modes that were placed with hardly any refinement between them are a second
        start: they cannot run into each other while others are missing.
        """
        believed = self._believed
        if self.problem is not self.plain:  # records weigh otherwise by now
            again = self.fit(believed.fit.omegas, believed.fit.zetas, believed.fit.clock)
            believed = Tried(again, believed.entry)
        self.max_iterations = 2 * _ITERATIONS
        starts = [self.chosen, self._pursued(limit)] if self._is_unsettled else [self.chosen]
        if not len(believed.fit.omegas) and self._is_unsettled and not any(map(self.is_promising, starts)):
            return False
        found = None
        for start in sorted(starts, key=self._bic):
            if (found := self._pruned(start, believed.fit)) is not None:
                break
        is_better = found is not None and self._bic(found.fit) < self._bic(believed.fit)
        self._present = self._believed = found if found is not None and is_better else believed
        return found is not None

    def _pruned(self, start: ModalFit, believed: ModalFit) -> Tried | None:
        """Return a fit without the modes, of a start, that do not pass the gates; None where too few would be left.

        A few steps show which modes are none: to refine them in full, towards an optimum that they do not have, takes
        longer than the search itself wherever something else than modes is left.
        """
        fit = start
        fewest = max(len(believed.omegas) + 1, len(start.omegas) - _MOST_LEFT_OUT)
        while len(fit.omegas) >= fewest:
            fit = self.fit(fit.omegas, fit.zetas, fit.clock, SHORT)
            doubtful = self._doubtful(fit)
            if not doubtful and not fit.converged:
                fit = self.fit(fit.omegas, fit.zetas, fit.clock)
                doubtful = self._doubtful(fit)
            refusal = self._refusal(fit, believed, is_given=False)
            tried = self._listed(fit, refusal)
            if not refusal:
                return tried
            among = doubtful or range(len(fit.omegas))
            weakest = min(among, key=lambda mode: mode_significance(fit, self.problem, mode, self.band)[0])
            fit = dataclasses.replace(
                fit, omegas=np.delete(fit.omegas, weakest), zetas=np.delete(fit.zetas, weakest)
            )
        return None

    def _pursued(self, limit: int) -> ModalFit:
        """Return modes placed one after the other as long as the criterion falls, refined by a few steps each."""
        fit = self.fit(np.empty(0), np.empty(0), self.chosen.clock)
        while (n := len(fit.omegas)) < limit and self._affords(n + 1):
            self.progress(f"placing mode {n + 1}", 0.95)
            candidates = self.propose(fit, ())
            if not candidates:
                break
            starts = [(np.append(fit.omegas, c.omega), np.append(fit.zetas, c.zeta)) for c in candidates]
            trials = [self.fit(*start, fit.clock, _GLANCE) for start in starts]
            trial = min(trials, key=lambda own: own.cost)
            if not self._bic(trial) < self._bic(fit):
                break
            fit = trial
        return fit

    @property
    def _clock_meant(self) -> ClockState:
        return ClockState(self.latency.mean, self.clock_rate.mean)

    def _affords(self, n_modes: int) -> bool:
        unknowns = self.problem.n_columns(n_modes) + 2 * n_modes
        rows = _ROWS_PER_UNKNOWN * (1 if self.problem.is_noise_known else 2)
        return min(len(v) for v in self.problem.values) > rows * unknowns

    def _target(self, current: ModalFit, n_modes: int | None) -> float:
        """Return the cost below which one more mode is worth its parameters."""
        if n_modes is not None:
            return math.inf
        return current.cost - 0.5 * self.problem.n_parameters_of_a_mode * math.log(self.problem.n_samples)

    def _bic(self, fit: ModalFit) -> float:
        return 2.0 * fit.cost + fit.n_parameters * math.log(self.problem.n_samples)

    def _refusal(self, trial: ModalFit, current: ModalFit, is_given: bool) -> str:
        if trial.reason == HOPELESS:
            return "not worth its parameters by BIC"
        if not is_given and (near := crowd(trial, self.problem, self.band)):
            hertz = trial.omegas[near[0]] / (2.0 * np.pi)
            return f"{len(near)} poles at {hertz:.4g} Hz move alike, as one does that goes with the amplitude"
        if not trial.converged:
            return f"the fit did not converge: {trial.reason}"
        for mode in range(len(trial.omegas)):
            complaint = mode_complaint(trial, self.problem, mode, self.band)
            if complaint:
                return complaint
        if not is_given and not self._bic(trial) < self._bic(current):
            return "not worth its parameters by BIC"
        return ""

    def _entry(self, fit: ModalFit, refusal: str) -> OrderEntry:
        scores = [
            Scores.of(values, residuals)
            for values, residuals in zip(self.problem.values, fit.residuals, strict=True)
        ]
        return OrderEntry(
            n_modes=len(fit.omegas),
            n_parameters=fit.n_parameters,
            bic=self._bic(fit),
            aic=2.0 * fit.cost + 2.0 * fit.n_parameters,
            r_squared=min(own.r_squared for own in scores),
            worst_fit_percent=min(own.fit_percent for own in scores),
            condition=fit.information_condition,
            converged=fit.converged,
            refused_because=refusal,
            weighed_by="" if self.problem is self.plain else self.weighed_by,
        )

    def _confirmed(self, weighed: Weighed[ProblemT]) -> Weighed[ProblemT]:
        """Return the fit without modes that only the weights of the search had mistaken for more than noise.

        Noise on the input reaches the outputs through the modes, and a mode beside a true one can pass for it
        until every sample weighs by what the noise has left of it.  Of many doubtful modes half are left out at once.
        """
        found = [(weighed, self._present.entry, self._doubts_of(weighed))]
        while len((fit := weighed.fit).omegas) > 1:
            doubtful = list(doubts := found[-1][2])
            if fit.converged and not doubtful:
                break
            among = doubtful or range(len(fit.omegas))
            by_weight = {mode: mode_significance(fit, weighed.problem, mode, self.band)[0] for mode in among}
            weakest = sorted(by_weight, key=by_weight.__getitem__)[: max(len(doubtful) // 2, 1)]
            omegas, zetas = np.delete(fit.omegas, weakest), np.delete(fit.zetas, weakest)
            fewer = self.fit(omegas, zetas, fit.clock)
            following = self.weighed(fewer)
            if not doubtful:
                # It only does not settle: a mode is given up for one that does, where little is lost.
                beside = np.min(np.abs(np.log(omegas / fit.omegas[weakest[0]])))
                is_little = np.all(following.fit.sigmas < _HARDLY_MORE * fit.sigmas)
                settles = fewer.converged and following.fit.converged
                if not (settles and beside < _BESIDE and is_little):
                    break
            reason = doubts.get(weakest[0], fit.reason)
            self.entries[found[-1][1]] = dataclasses.replace(
                self.entries[found[-1][1]], refused_because=f"weighed by the noise, {reason}"
            )
            weighed = following
            found.append((weighed, self._listed(fewer, "").entry, self._doubts_of(weighed)))
        weighed, entry, _ = min(reversed(found), key=lambda own: len(own[2]))
        self._present = Tried(self.chosen, entry)
        return weighed

    def _doubts_of(self, weighed: Weighed[ProblemT]) -> dict[int, str]:
        """Return why modes of a weighed fit cannot be trusted, by their numbers."""
        modes = range(len(weighed.fit.omegas))
        said = {mode: mode_complaint(weighed.fit, weighed.problem, mode, self.band) for mode in modes}
        return {mode: complaint for mode, complaint in said.items() if complaint}


def _is_same(one: ModalFit, other: ModalFit) -> bool:
    """Return whether two fits of one problem ended in the same optimum."""
    return len(one.omegas) == len(other.omegas) and abs(one.cost - other.cost) < _SAME
