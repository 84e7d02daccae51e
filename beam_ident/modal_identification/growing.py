"""Identify a modal model while its records grow: the offline estimate, again and again, from where it ended before.

There is no second estimator and no recursion. A *search* is what ``identify`` does on what has arrived. A *refit*
takes modes, clocks and whatever else the last search found, and lets all samples say where they are now: the last
step of the same search, begun at its own end. It takes about a tenth of a search. Another search is made when the
record has grown by a share, and as soon as a refit leaves residuals that are not white where they were: then
something is missing. On the way a search ends early where it has used as much time as the whole record pays for;
the one at the end takes what it takes. So the last answer, from a search on everything, is that of ``identify``.

What is done when follows from what it costs: an estimate begins when enough was heard to pay for the ones before, at
a given share of one processor, and for another search. The time for a fit goes with the duration of the record, and
so does the time until the next: the estimate is behind by about the same share of the record at any length.

A record may forget what is old. What was heard then goes on, though the record grows no longer: it is what pays, and
the part of the record that is new is what asks for a search.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from beam_ident.data.batches import Progress
from beam_ident.data.growing_record import GrowingRecord
from beam_ident.data.prior import Prior
from beam_ident.data.records import TimeRecord
from beam_ident.errors import EstimationError
from beam_ident.modal.aims import Aim
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.modal.structure import ModalStructure, StructureKind
from beam_ident.modal_estimation.mode_search import MAX_MODES
from beam_ident.modal_identification.time_domain import Reached, identified, refitted
from beam_ident.numerics.blas_threads import one_blas_thread

Growing = TimeRecord | Sequence[TimeRecord] | GrowingRecord


@dataclass(frozen=True)
class _Arrived:
    """Records as they are, and how much was heard until then [s]: more than they last where they forget."""

    records: list[TimeRecord]
    heard_s: float

    @property
    def duration_s(self) -> float:
        return duration_of(self.records)


class GrowingIdentification:
    """The modes of one record, or of several of one system, that still grow.

    Parameters
    ----------
    structure, n_modes, latency, clock_rate, input_name, max_modes : optional
        As ``identify`` takes them.
    share_of_core : float -- of one processor's time, over the time that was heard, that estimates may take
    growth : float -- a search is due when as much is new as makes the record of the last one so many times as long
    processor_time : callable -- returns the time that this process has spent [s]
    progress : callable or None -- as ``identify`` takes it, of searches

    Attributes
    ----------
    result : IdentificationResult or None -- the newest estimate
    complaint : str -- why there is no newer one, empty where nothing is amiss
    seconds_of_last_fit : float -- processor time of the newest estimate [s]
    spent_s : float -- processor time of all of them [s]

    Raises
    ------
    EstimationError
        A share or a growth that cannot be.
    """

    def __init__(
        self,
        structure: StructureKind | ModalStructure | None = None,
        n_modes: int | None = None,
        latency: Prior | Mapping[str, Prior | float] | None = None,
        clock_rate: Prior | Mapping[str, Prior | float] | None = None,
        input_name: str | Sequence[str] | None = None,
        max_modes: int = MAX_MODES,
        *,
        share_of_core: float = 0.15,
        growth: float = 1.25,
        processor_time: Callable[[], float] = time.process_time,
        progress: Progress | None = None,
    ) -> None:
        if not share_of_core > 0.0 or not growth > 1.0:
            raise EstimationError(
                f"share_of_core is {share_of_core!r} and growth {growth!r}; expected above 0 and above 1"
            )
        self._structure, self._n_modes, self._max_modes = structure, n_modes, max_modes
        self._latency, self._clock_rate, self._input_name = latency, clock_rate, input_name
        self._share, self._growth = share_of_core, growth
        self._processor_time, self._progress = processor_time, progress
        self._reached: Reached | None = None
        self._searched: _Arrived | None = None
        self._begun_s: float | None = None  # before it nothing was heard [s]
        self.result: IdentificationResult | None = None
        self.complaint = ""
        self.seconds_of_last_fit = self.spent_s = self._seconds_of_search = 0.0

    @property
    def searched_s(self) -> float:
        """How much had been heard at the last search [s]; 0 before the first."""
        return 0.0 if self._searched is None else self._searched.heard_s

    def is_due(self, heard_s: float) -> bool:
        """Return whether the time that was heard [s] pays for the estimates so far, and for one more search."""
        return self.spent_s + self._seconds_of_search <= self._share * heard_s

    def grown(
        self, records: Growing, clock_rate: Prior | None = None, latency: Prior | None = None
    ) -> IdentificationResult | None:
        """Return the newest estimate; a new one is made where it is due.

        Parameters
        ----------
        records : TimeRecord, sequence of TimeRecord, or GrowingRecord -- as they are now
        clock_rate, latency : Prior or None -- what is known of them by now; None: as at the beginning

        Returns
        -------
        IdentificationResult or None -- None as long as no mode is found; ``complaint`` says why
        """
        if isinstance(records, GrowingRecord) and not self.is_due(records.heard_s):
            return self.result
        arrived = self._arrived(records)
        if self.is_due(arrived.heard_s) and (
            self._has_grown(arrived) or not self._is_refitted(arrived.records, clock_rate)
        ):
            self._search(arrived, clock_rate, latency, self._share * arrived.duration_s)
        return self.result

    def searched(
        self,
        records: Growing,
        clock_rate: Prior | None = None,
        latency: Prior | None = None,
        limit_s: float = math.inf,
    ) -> IdentificationResult | None:
        """Return what ``identify`` finds in the records as they are now, whether that is due or not.

        A search that finds nothing, or takes more processor time than ``limit_s``, leaves the result before it in
        place, if there is one, and says why in ``complaint``.
        """
        return self._search(self._arrived(records), clock_rate, latency, limit_s)

    def _search(
        self, arrived: _Arrived, clock_rate: Prior | None, latency: Prior | None, limit_s: float
    ) -> IdentificationResult | None:
        self._searched, ends = arrived, list[Reached]()
        begun = self._processor_time()
        try:
            with one_blas_thread():
                found = identified(
                    arrived.records,
                    self._structure,
                    self._n_modes,
                    latency or self._latency,
                    clock_rate or self._clock_rate,
                    self._input_name,
                    self._max_modes,
                    self._limited(begun + limit_s),
                    ends,
                )
        except (EstimationError, TimeoutError) as err:
            self.complaint = str(err)
        else:
            # Of several searches, as for delays far apart, the one that was believed; none where it was moved since.
            reached = next((own for own in ends if own.end.result.model is found.model), None)
            is_stopped = reached is not None and reached.end.stopped_by is not None
            self.complaint = found.reason if is_stopped else ""
            if self.result is None or not is_stopped:
                self.result, self._reached = found, reached
        self._pay(begun)
        self._seconds_of_search = self.seconds_of_last_fit
        return self.result

    def _limited(self, end_s: float) -> Progress:
        """Return a progress that ends a search at a processor time [s]."""

        def progress(phrase: str, share: float) -> None:
            if self._progress is not None:
                self._progress(phrase, share)
            if self._processor_time() > end_s:
                raise TimeoutError("the search took longer than the record pays for")

        return progress

    def knows(self, records: Growing, aims: Sequence[Aim], clock_rate: Prior | None = None) -> bool:
        """Return whether aims are met, by a search on the records as they are now.

        A refit keeps the modes that were there; only a search says that no other set of them explains the records
        better by now. So it is asked for wherever a refit promises the aims. A mode that is doubted meets no aim.
        """
        if not self._meets(aims):
            return False
        arrived = self._arrived(records)
        if not self._is_searched(arrived):
            self._search(arrived, clock_rate, None, math.inf)
        return not self.complaint and self._meets(aims)

    def _meets(self, aims: Sequence[Aim]) -> bool:
        result = self.result
        if result is None or not result.converged:
            return False
        return all(
            aim.seconds_to_go(result.model, 1.0) == 0.0 and not result.doubts[aim.mode - 1] for aim in aims
        )

    def _is_searched(self, arrived: _Arrived) -> bool:
        """Return whether nothing has come since the last search."""
        last = self._searched
        return last is not None and (len(last.records), last.heard_s) == (
            len(arrived.records),
            arrived.heard_s,
        )

    def _has_grown(self, arrived: _Arrived) -> bool:
        """Return whether much is new since the last search, beside what it was made of."""
        last = self._searched
        if last is None or len(last.records) != len(arrived.records):
            return True
        return arrived.heard_s - last.heard_s >= (self._growth - 1.0) * last.duration_s

    def _arrived(self, records: Growing) -> _Arrived:
        if isinstance(records, GrowingRecord):
            return _Arrived([records.record()], records.heard_s)
        present = [records] if isinstance(records, TimeRecord) else list(records)
        duration_s = duration_of(present)
        newest_s = max(one.start_ns * 1e-9 + one.inputs[0].span_s[1] for one in present)
        if self._begun_s is None:
            self._begun_s = newest_s - duration_s
        return _Arrived(present, max(duration_s, newest_s - self._begun_s))

    def _is_refitted(self, records: Sequence[TimeRecord], clock_rate: Prior | None) -> bool:
        """Let all samples say where the modes are that were found; return whether no search is asked for."""
        if self._reached is None:
            return True
        begun = self._processor_time()
        try:
            with one_blas_thread():
                reached = refitted(self._reached, records, clock_rate)
                result = reached.end.result
        except EstimationError:
            return False
        finally:
            self._pay(begun)
        was_white, self._reached, self.result = self._are_white(), reached, result
        # The score asks for a search: residuals hold more than noise by now.
        return all(is_white for is_white, was in zip(self._are_white(), was_white, strict=False) if was)

    def _are_white(self) -> list[bool]:
        return [] if self.result is None else [own.whiteness.is_white for own in self.result.outputs]

    def _pay(self, begun: float) -> None:
        self.seconds_of_last_fit = self._processor_time() - begun
        self.spent_s += self.seconds_of_last_fit


def duration_of(records: Sequence[TimeRecord]) -> float:
    """Return for how long the inputs of records are known, all together [s]."""
    return sum(last - first for first, last in (one.inputs[0].span_s for one in records))
