"""What shall be known of a model: relative standard deviations of single modes, and when they are reached.

An experiment may end as soon as the standard deviations that the fit states are as small as was asked (Chow and
Robbins, Annals of Mathematical Statistics 36, 1965): the interval that is stated then covers as often as it says,
for the stated deviation hardly depends on how the estimate itself has come out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel

_WORDS = re.compile(r"\s*(f|zeta)([1-9]\d*)\s*:\s*([0-9.eE+-]+)\s*(%?)\s*")


@dataclass(frozen=True)
class Aim:
    """A quantity of a mode, and the relative standard deviation to which it shall be known.

    Attributes
    ----------
    quantity : {"f", "zeta"} -- natural frequency, or damping ratio
    mode : int -- from 1, by rising natural frequency
    relative_sd : float

    Raises
    ------
    EstimationError
        A mode below 1, or a standard deviation that is not between 0 and 1.
    """

    quantity: Literal["f", "zeta"]
    mode: int
    relative_sd: float

    def __post_init__(self) -> None:
        if self.mode < 1 or not 0.0 < self.relative_sd < 1.0:
            raise EstimationError(
                f"aim {self.name}: the relative standard deviation is {self.relative_sd!r}; expected more than 0 and "
                "less than 1 (100 %), of a mode counted from 1"
            )

    @property
    def name(self) -> str:
        """As it is written: ``f1``, ``zeta2``."""
        return f"{self.quantity}{self.mode}"

    def relative_sd_of(self, model: ModalModel) -> float:
        """Return the relative standard deviation that a model states; infinite without such a mode."""
        place = self.mode - 1
        if place >= model.n_modes:
            return math.inf
        values = model.natural_frequencies if self.quantity == "f" else model.damping_ratios
        sds = model.natural_frequency_sd if self.quantity == "f" else model.damping_ratio_sd
        return float(sds[place] / abs(values[place])) if sds[place] > 0.0 else math.inf

    def seconds_to_go(self, model: ModalModel, duration_s: float) -> float:
        """Return how much longer records like these must be [s], 0 where the aim is met; infinite: unknown.

        Information grows with the duration at least in proportion, so that variances fall with its inverse.
        """
        excess = self.relative_sd_of(model) / self.relative_sd
        return max(0.0, duration_s * (excess**2 - 1.0))


def aims_of(text: str) -> tuple[Aim, ...]:
    """Read aims as a person writes them: ``f1:0.01%, zeta1:2%``.

    Raises
    ------
    EstimationError
        Anything else, nothing at all, or one quantity twice.
    """
    found = []
    for word in text.split(","):
        match = _WORDS.fullmatch(word)
        try:
            sd = float(match[3]) * (0.01 if match[4] else 1.0) if match else math.nan
        except ValueError:
            match = None
        if match is None:
            raise EstimationError(
                f"aim {word.strip()!r} in {text!r}; expected f1:0.01% or zeta1:2% (quantity, mode, relative standard "
                "deviation), with commas between"
            )
        found.append(Aim("f" if match[1] == "f" else "zeta", int(match[2]), sd))
    names = [aim.name for aim in found]
    for name in names:
        if names.count(name) > 1:
            raise EstimationError(f"{name} stands twice in {text!r}; expected each quantity once")
    return tuple(found)


def most_to_go(aims: Sequence[Aim], model: ModalModel, duration_s: float) -> float:
    """Return how much longer it takes until the last of several aims is met [s]."""
    return max((aim.seconds_to_go(model, duration_s) for aim in aims), default=0.0)
