"""One case: run within a bound of time, and what is to be thought of what came out."""

from __future__ import annotations

import functools
import re
import signal
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from beam_ident import IdentificationError
from tests.beam_ident.bad_input.estimators import ESTIMATORS, TRUTH, Said
from tests.beam_ident.bad_input.experiments import EXPERIMENTS
from tests.beam_ident.bad_input.faults import FAULTS

MOST_S = 20.0  # of processor time
FAR = 3.0  # standard deviations that a fault may move an answer without a word
BY_CHANCE = (
    5.0  # up to here another draw of the noise is asked: of a thousand right answers three are off by FAR
)
UNSTATED = 0.01  # of a value: its deviation where an estimator states none
NOTHING = (
    "no more than chance"  # a result that says so of itself is a refusal, whatever it was estimated from
)


class TooSlow(BaseException):
    """The bound of time has passed; no estimator catches it."""


@dataclass(frozen=True)
class Verdict:
    """What came of a case.

    Attributes
    ----------
    kind : str
        "error", "named", "refused", "not converged", "right"; or "silent", "crash", "too slow", which are failures.
    text : str -- the message, the warning, or how far off the answer is
    seconds : float
    distance : float -- by how many standard deviations a silent answer is off
    """

    kind: str
    text: str
    seconds: float
    distance: float = 0.0

    @property
    def is_failure(self) -> bool:
        """Whether a person would be misled, or left without a word."""
        return self.kind in ("silent", "crash", "too slow")


@contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """Raise TooSlow where a block takes longer, in processor time."""

    def stop(*_: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@functools.cache
def sound(estimator: str, draw: int = 0) -> Said:
    """Return what an estimator says of its sound record, under one draw of the outputs' noise."""
    row = ESTIMATORS[estimator]
    return row.run(EXPERIMENTS[row.experiment](draw).record())


def judge(estimator: str, fault: str) -> Verdict:
    """Run one case and say what came of it; an answer that is a little too far off has to be so twice."""
    verdict = _judged(estimator, fault, 0)
    return _judged(estimator, fault, 1) if FAR < verdict.distance < BY_CHANCE else verdict


def _judged(estimator: str, fault: str, draw: int) -> Verdict:
    """Run one case under one draw of the outputs' noise."""
    row, bad = ESTIMATORS[estimator], FAULTS[fault]
    reference = sound(estimator, draw)
    start = time.process_time()
    try:
        with bounded(MOST_S), warnings.catch_warnings():
            warnings.simplefilter("error")
            said = row.run(bad.spoil(EXPERIMENTS[row.experiment](draw)).record())
    except TooSlow:
        return Verdict("too slow", f"more than {MOST_S} s", MOST_S)
    except IdentificationError as err:
        return Verdict("error", str(err), time.process_time() - start)
    except (
        ArithmeticError,
        AssertionError,
        LookupError,
        RuntimeError,
        TypeError,
        ValueError,
        Warning,
    ) as err:
        # What is not of the library's own classes is a failure of the library.
        return Verdict("crash", f"{type(err).__name__}: {err}", time.process_time() - start)
    seconds = time.process_time() - start
    new = [text for text in said.warnings if text not in reference.warnings]
    named = [text for text in new if bad.names and re.search(bad.names, text, re.IGNORECASE)]
    if named:
        return Verdict("named", named[0], seconds)
    if refusals := [text for text in new if re.search(NOTHING, text, re.IGNORECASE)]:
        return Verdict("refused", refusals[0], seconds)
    if not said.converged:
        return Verdict("not converged", said.reason, seconds)
    off = {name: _distance(name, said, reference, bad.factors, row.is_model) for name in said.values}
    worst = max(off, key=lambda name: off[name], default="")
    if worst and not off[worst] <= FAR:
        found = ", ".join(f"{name} {value:.2f} sd" for name, value in off.items())
        return Verdict("silent", f"{found}; said: {' / '.join(new) or 'nothing'}", seconds, off[worst])
    return Verdict("right", f"{off[worst]:.2g} sd" if worst else "", seconds)


def _distance(name: str, said: Said, reference: Said, factors: Mapping[str, float], is_model: bool) -> float:
    """Return how far an answer is from the truth, or from that of the sound record, in standard deviations."""
    value, sd = said.values[name]
    factor = factors.get(name, 1.0)
    if np.isinf(factor):
        return 0.0
    goals = [TRUTH[name]] if is_model and name in TRUTH else []
    goals += [reference.values[name][0]] if name in reference.values else []
    if not np.isfinite(value) or not goals:
        return np.inf
    distance = min(abs(value - factor * goal) for goal in goals)
    unit = sd if np.isfinite(sd) and sd > 0.0 else UNSTATED * abs(factor * goals[0])
    return float(distance / unit)
