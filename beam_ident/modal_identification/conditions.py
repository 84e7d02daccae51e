"""What is believed of records beside their modes: clocks, low-passes, samples that count, noise of the input."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from beam_ident.data.own_clocks import OwnClock, on_common_clock, with_low_passes
from beam_ident.data.records import LowPass, TimeRecord
from beam_ident.data.stamp_jumps import ClockJump, without_jumps
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.structure import ModalStructure
from beam_ident.sensing.still_noise import StillNoise


@dataclass(frozen=True, eq=False)
class Conditions:
    """What is believed of records beside their modes; each move of the search changes one thing of it.

    Attributes
    ----------
    measured : sequence of TimeRecord -- with the stamps that they came with; samples that do not count are NaN
    terms : ModalStructure
    jumps : tuple of ClockJump -- steps of the stamps' clocks
    clocks, low_passes : mapping -- of outputs that have their own, by name
    found_noise : mapping -- of the records whose input did not state its own
    start : ModalFit or None -- modes that the search begins with
    highest_hz : float -- where no mode is looked for beyond
    sentences : mapping -- what must be known of it, by the kind of move
    """

    measured: Sequence[TimeRecord]
    terms: ModalStructure
    jumps: tuple[ClockJump, ...] = ()
    clocks: Mapping[str, OwnClock] = field(default_factory=dict)
    low_passes: Mapping[str, LowPass] = field(default_factory=dict)
    found_noise: Mapping[int, StillNoise] = field(default_factory=dict)
    start: ModalFit | None = None
    highest_hz: float = math.inf
    sentences: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def steady(self) -> list[TimeRecord]:
        """The records on clocks that do not jump, each output on its own."""
        return [without_jumps(own, number, self.jumps) for number, own in enumerate(self.measured)]

    @cached_property
    def records(self) -> list[TimeRecord]:
        """The records on one clock in common, each output behind its low-pass."""
        return with_low_passes([on_common_clock(one, self.clocks) for one in self.steady], self.low_passes)

    def moved(self, further: Mapping[str, OwnClock]) -> Conditions:
        """Return them with clocks of single outputs further on, by name; the present ones keep theirs."""
        moved = {
            name: self.clocks.get(name, OwnClock()).moved(own.delay, own.rate)
            for name, own in further.items()
        }
        return replace(self, clocks={**self.clocks, **moved})
