"""Verdicts of a check, one line each: what every page and table that judges data is made of.

A gate says what was looked at, what was found there, what was expected, and what to do where that differs.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

Verdict = Literal["passed", "doubtful", "failed", "not judged"]
"""What a gate can say: "not judged" where the data do not hold what it would need."""


@dataclass(frozen=True)
class Gate:
    """One verdict.

    Attributes
    ----------
    name : str -- what was looked at
    verdict : str -- "passed", "doubtful", "failed" or "not judged"
    figure : str -- what was found, with its unit
    expected : str -- what would pass
    remedy : str -- what to do; empty where nothing needs doing
    """

    name: str
    verdict: Verdict
    figure: str
    expected: str
    remedy: str = ""

    @staticmethod
    def judged(name: str, is_good: bool, figure: str, expected: str, remedy: str) -> Gate:
        """Return a gate that passed and needs no remedy, or one that is doubtful."""
        return (
            Gate(name, "passed", figure, expected)
            if is_good
            else Gate(name, "doubtful", figure, expected, remedy)
        )

    def to_dict(self) -> dict[str, str]:
        """Return the gate as plain words, for JSON."""
        return asdict(self)
