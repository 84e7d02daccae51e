"""What every study is: a case that can identify one seeded record, and the figures of many of them.

A study module registers its cases in a dictionary ``STUDIES`` of `Study` by name.  A case is
made once, before the processes are, so that it may hold whatever is dear to make.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np

from beam_ident import ModalModel


@dataclasses.dataclass(frozen=True)
class Outcome:
    """One run: the estimate and its stated standard deviations (None after a failure), and the time it took [s].

    ``figures`` are further numbers of the run, for a case with a summary of its own.
    """

    seconds: float
    estimate: np.ndarray | None = None
    sd: np.ndarray | None = None
    figures: dict[str, float] = dataclasses.field(default_factory=dict)

    @staticmethod
    def of_modes(seconds: float, model: ModalModel, n_modes: int) -> Outcome:
        """Return frequencies and damping ratios of a model; another number of modes is a failure."""
        if model.n_modes != n_modes:
            return Outcome(seconds)
        return Outcome(
            seconds,
            np.concatenate([model.natural_frequencies, model.damping_ratios]),
            np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd]),
        )


class Case(Protocol):
    """What a study runs, once for each seed."""

    def run(self, seed: int) -> Outcome:
        """Identify the record of one seed."""

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the figures of all runs, by name, fit for a line of a table."""


@dataclasses.dataclass(frozen=True)
class Study:
    """A named case with the number of runs of its full form."""

    title: str
    runs: int
    make_case: Callable[[], Case]


class AgainstBound:
    """The figures of a case with a known truth and a known bound.

    A run fails without an estimate, or with any parameter more than ten bounds away.
    Subclasses set ``truth`` and ``bound``, both of shape (n_parameters,).
    """

    truth: np.ndarray
    bound: np.ndarray

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return failures, and how true estimates and stated standard deviations of the others are.

        ``bias`` is the mean error over the bound; ``mean z`` is that of every error over its own stated
        standard deviation, which also shows where that rises and falls with the estimate. Of normal errors
        0.001 lie beyond 3.3 standard deviations.
        """
        good = [o for o in outcomes if self.is_near(o)]
        failed = [seed for seed, o in enumerate(outcomes) if not self.is_near(o)]
        figures: dict[str, Any] = {"failures": len(failed)}
        if failed:
            figures["failed seeds"] = failed[:20]
        if good:
            errors = np.array([o.estimate - self.truth for o in good])
            signed = errors / np.array([o.sd for o in good])
            scores = np.abs(signed)
            efficiency = self.bound**2 / np.mean(errors**2, axis=0)
            figures |= {
                "efficiency": [round(float(e), 3) for e in efficiency],
                "coverage": round(float(np.mean(scores < 1.96)), 4),
                "worst coverage": round(float(np.min(np.mean(scores < 1.96, axis=0))), 4),
                "bias": [round(float(b), 2) for b in np.mean(errors, axis=0) / self.bound],
                "mean z": [round(float(z), 2) for z in np.mean(signed, axis=0)],
                "beyond 3.3 sd": round(float(np.mean(scores > 3.3)), 5),
                "max |z|": round(float(np.max(scores)), 2),
            }
        return figures

    def is_near(self, outcome: Outcome) -> bool:
        """Return whether a run found the truth within ten bounds."""
        if outcome.estimate is None or outcome.sd is None:
            return False
        return bool(np.all(np.abs(outcome.estimate - self.truth) <= 10.0 * self.bound))


def stated_bound(stated: Callable[[int], np.ndarray], records: int = 9) -> np.ndarray:
    """Return the middle of what several records state, where noise that is left out would change the plant.

    Parameters
    ----------
    stated : callable -- standard deviations of the record of one seed, shape (n_parameters,)
    records : int -- how many, of seeds that no study takes
    """
    return np.asarray(np.median([stated(10**6 + seed) for seed in range(records)], axis=0))


_case: Case | None = None


def _prepare(case: Case) -> None:
    global _case
    _case = case


def _run(seed: int) -> Outcome:
    assert _case is not None
    return _case.run(seed)


def outcomes(case: Case, runs: int, workers: int) -> Iterator[Outcome]:
    """Yield the outcome of every seed, in order, from ``workers`` processes that begin with the case as it is."""
    if workers == 1:
        yield from map(case.run, range(runs))
        return
    context = multiprocessing.get_context("fork")
    with context.Pool(workers, initializer=_prepare, initargs=(case,)) as pool:
        yield from pool.imap(_run, range(runs), chunksize=2)


def figures(
    study: Study, runs: int | None = None, workers: int = 1, progress: bool = False
) -> dict[str, Any]:
    """Run a study and return its line of the table."""
    from tqdm import tqdm

    runs, case = runs or study.runs, study.make_case()
    done = list(tqdm(outcomes(case, runs, workers), study.title, runs, disable=not progress, leave=False))
    return {
        "study": study.title,
        "runs": runs,
        **case.summarise(done),
        "median s": round(float(np.median([o.seconds for o in done])), 4),
    }
