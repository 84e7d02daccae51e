"""An experiment that goes on until the modes are known as well as was asked, or the time is up.

It is made of segments. The first is the rig's own excitation, shortened; each further one is designed from what the
segments before it have told, for the aim that is farthest away. After each segment all of them are identified
together, as one fit; the experiment is over when that meets the aims.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

from beam_ident import Aim, GrowingIdentification, ModalModel
from beam_ident.modal.identification_result import IdentificationResult
from beam_ros.errors import UsageError
from beam_ros.excitation.optimal import RigDesign, design_for_rig
from beam_ros.excitation.plan import plan_excitation
from beam_ros.offline.loading.experiment import Experiment
from beam_ros.rig.rig import Rig

RecordSegment = Callable[[Rig, int], Experiment]
"""Called with a rig and the segment's number: checks the sequence, hands it over, records, and reads the bag."""


class DesignExcitation(Protocol):
    """Designs the next excitation of a rig from what is known."""

    def __call__(self, rig: Rig, criterion: str, identified: ModalModel) -> RigDesign:
        """Design it; UsageError where nothing can be designed."""


@dataclass(frozen=True)
class KnownSegment:
    """A segment that was recorded, and what all segments so far told after it.

    Attributes
    ----------
    excitation : str -- which kind, and from what it was designed
    duration_s : float
    n_modes : int
    relative_sd : dict of str to float -- of every aim; infinite where its mode is not known
    seconds_to_go : float -- as the last design predicts, or else by the duration so far; infinite: unknown
    """

    excitation: str
    duration_s: float
    n_modes: int
    relative_sd: dict[str, float]
    seconds_to_go: float

    @property
    def known(self) -> str:
        """How well every aim's quantity is known, in words."""
        return ", ".join(_known(name, sd) for name, sd in self.relative_sd.items())


@dataclass(frozen=True, eq=False)
class UntilOutcome:
    """How an experiment with aims ended.

    Attributes
    ----------
    aims : tuple of Aim
    segments : tuple of KnownSegment
    result : IdentificationResult or None -- of all segments together; None where no mode was found
    is_known : bool -- the aims are met
    chirp_s : float
        How long fixed chirps of a segment's length, one after the other, would have taken for the same; NaN where
        no design says it
    complaint : str -- why nothing was found, empty otherwise
    """

    aims: tuple[Aim, ...]
    segments: tuple[KnownSegment, ...]
    result: IdentificationResult | None
    is_known: bool
    chirp_s: float
    complaint: str = ""

    @property
    def duration_s(self) -> float:
        """All segments together [s]."""
        return sum(own.duration_s for own in self.segments)

    @property
    def sentence(self) -> str:
        """How it ended, and what it cost."""
        count = f"{len(self.segments)} {'segment' if len(self.segments) == 1 else 'segments'}"
        cost = f"{self.duration_s:.1f} s in {count}"
        if self.result is None:
            return f"Nothing is known after {cost}: {self.complaint}"
        beside = ""
        if math.isfinite(self.chirp_s):
            beside = f"; the best chirps would take about {self.chirp_s:.0f} s"
        if self.is_known:
            return f"Known as well as was asked after {cost}{beside}."
        last = self.segments[-1]
        missing = ", ".join(
            f"{_known(aim.name, last.relative_sd[aim.name])}, {_percent(aim.relative_sd)} asked"
            for aim in self.aims
            if not last.relative_sd[aim.name] <= aim.relative_sd
        )
        said = missing or "the aims by their deviations, and a mode of them is doubted"
        to_go = last.seconds_to_go
        longer = f"about {to_go:.0f} s more" if math.isfinite(to_go) else "a time that is not known yet"
        return f"The time is up after {cost}. Known is {said}: it would take {longer}."

    def to_dict(self) -> dict[str, Any]:
        """Return it in plain numbers, for a machine."""
        model = None if self.result is None else self.result.model
        return {
            "sentence": self.sentence,
            "is_known": self.is_known,
            "duration_s": self.duration_s,
            "chirp_s": self.chirp_s,
            "aims": {own.name: own.relative_sd for own in self.aims},
            "segments": [asdict(own) for own in self.segments],
            "modes": []
            if model is None
            else [
                {
                    "frequency_hz": float(model.frequencies_hz[k]),
                    "frequency_sd_hz": float(model.frequency_sd_hz[k]),
                    "damping_ratio": float(model.damping_ratios[k]),
                    "damping_ratio_sd": float(model.damping_ratio_sd[k]),
                }
                for k in range(model.n_modes)
            ],
            "model": None if model is None else model.to_dict(),
            "warnings": [] if self.result is None else list(self.result.warnings),
        }


def experiment_until(
    rig: Rig,
    aims: Sequence[Aim],
    record: RecordSegment,
    longest_s: float,
    segment_s: float,
    *,
    design: DesignExcitation = design_for_rig,
    told: Callable[[KnownSegment], None] = lambda segment: None,
) -> UntilOutcome:
    """Record segment after segment until aims are met.

    Parameters
    ----------
    rig : Rig -- with the excitation that begins
    aims : sequence of Aim
    record : callable -- records one segment
    longest_s : float -- the time that all segments together may take [s]
    segment_s : float -- duration of a segment [s]
    design : callable -- designs the next excitation
    told : callable -- called after every segment

    Raises
    ------
    UsageError
        The time is shorter than a segment; whatever ``record`` raises.
    """
    if not 0.0 < segment_s <= longest_s:
        raise UsageError(
            f"the longest time is {longest_s:g} s and a segment {segment_s:g} s; expected a segment above 0 s that "
            "fits into the time: give more --time, or a shorter --segment"
        )
    experiments: list[Experiment] = []
    segments: list[KnownSegment] = []
    here, kind, predicted = of_length(rig, segment_s), f"{rig.excitation.kind} of the rig", None
    chirp_s = math.nan
    while True:
        plan_excitation(here)
        experiments.append(record(here, len(segments) + 1))
        first = experiments[0]
        if not segments:
            growing = GrowingIdentification(first.structure)  # type: ignore[arg-type]
        records = [own for one in experiments for own in one.records]
        result = growing.searched(records, first.clock_rate, first.latency)
        is_known = growing.knows(records, aims, first.clock_rate)
        spent_s = len(experiments) * segment_s
        model = None if result is None else result.model
        segments.append(
            _segment(kind, segment_s, aims, model, _to_go(aims, model, spent_s, predicted, segment_s))
        )
        told(segments[-1])
        if is_known and predicted is not None and model is not None:
            chirp_s = max(_alone(own, model, predicted.design.chirp.pole_sd, segment_s) for own in aims)
        if is_known or spent_s + segment_s > longest_s:
            return UntilOutcome(tuple(aims), tuple(segments), result, is_known, chirp_s, growing.complaint)
        if model is not None:
            here, kind, predicted = _next(rig, aims, model, segment_s, design)


def _segment(
    kind: str, duration_s: float, aims: Sequence[Aim], model: ModalModel | None, seconds_to_go: float
) -> KnownSegment:
    """Return a segment with what all so far told: nothing where there is no model."""
    if model is None:
        return KnownSegment(kind, duration_s, 0, {own.name: math.inf for own in aims}, seconds_to_go)
    known = {own.name: own.relative_sd_of(model) for own in aims}
    return KnownSegment(kind, duration_s, model.n_modes, known, seconds_to_go)


def of_length(rig: Rig, duration_s: float) -> Rig:
    """Return a rig whose excitation takes another time, of which as large a share is still [s]."""
    excitation = rig.excitation
    share = excitation.still / (excitation.duration + excitation.still)
    still = round(share * duration_s, 3)
    return rig.with_values({"excitation.duration": round(duration_s - still, 3), "excitation.still": still})


def _next(
    rig: Rig, aims: Sequence[Aim], model: ModalModel, segment_s: float, design: DesignExcitation
) -> tuple[Rig, str, RigDesign | None]:
    """Return the next excitation: designed for the aim that is farthest, where its mode is known."""
    worst = max(aims, key=lambda own: own.relative_sd_of(model) / own.relative_sd)
    criterion = "D"
    if worst.mode <= model.n_modes:
        criterion = f"c:{_name(worst)}"
    here = of_length(rig, segment_s)
    try:
        found = design(here, criterion, model)
    except UsageError as err:
        return here, f"{rig.excitation.kind} of the rig, since {err}", None
    return found.rig, f"designed ({criterion}) from {model.n_modes} modes", found


def _to_go(
    aims: Sequence[Aim],
    model: ModalModel | None,
    spent_s: float,
    predicted: RigDesign | None,
    segment_s: float,
) -> float:
    """Return how much longer it takes with segments as the last one."""
    if model is None:
        return math.inf
    return max(_left(own, model, spent_s, predicted, segment_s) for own in aims)


def _left(
    aim: Aim, model: ModalModel, spent_s: float, predicted: RigDesign | None, segment_s: float
) -> float:
    """Return how much longer it takes until an aim is met: every segment brings as much information."""
    now, asked = aim.relative_sd_of(model), aim.relative_sd
    if now <= asked or not math.isfinite(now) or predicted is None:
        return aim.seconds_to_go(model, spent_s)
    sd = predicted.design.optimal.pole_sd.get(_name(aim), math.inf)
    return segment_s * sd**2 * (asked**-2 - now**-2)


def _alone(aim: Aim, model: ModalModel, pole_sd: dict[str, float], segment_s: float) -> float:
    """Return how long segments of one kind take alone for what is known now of an aim."""
    sd = pole_sd.get(_name(aim), math.inf)
    return segment_s * max(1.0, (sd / max(aim.relative_sd_of(model), aim.relative_sd)) ** 2)


def _name(aim: Aim) -> str:
    return f"{'omega' if aim.quantity == 'f' else 'zeta'}_{aim.mode}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _known(name: str, relative_sd: float) -> str:
    return f"{name} to {_percent(relative_sd)}" if math.isfinite(relative_sd) else f"{name} not at all"
