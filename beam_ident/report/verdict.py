"""What a report says first: whether the model can be relied on, in words, and why not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.report.evidence import Unseen
from beam_ident.report.gates import Gate
from beam_ident.report.page import Cell, Page, Tone
from beam_ident.results import Result

_POOR = ("poor", "fair")


@dataclass(frozen=True)
class Verdict:
    """The judgement of an identification.

    Attributes
    ----------
    tone : "good", "doubt" or "bad"
    text : str -- one sentence
    reasons : tuple of str -- what stands against the model; empty where nothing does
    """

    tone: Tone
    text: str
    reasons: tuple[str, ...]


def judge(result: Result, gates: Sequence[Gate] = (), unseen: Sequence[Unseen] = ()) -> Verdict:
    """Judge a result by its own end, by its data and by data that it has not seen.

    Parameters
    ----------
    result : Result
    gates : sequence of Gate -- of its data
    unseen : sequence of Unseen
    """
    against = [] if result.converged else [f"the estimation did not come to its end ({result.reason})"]
    against += [f"the data fail at {gate.name}: {gate.figure}" for gate in gates if gate.verdict == "failed"]
    doubts = [f"doubtful data: {gate.name}, {gate.figure}" for gate in gates if gate.verdict == "doubtful"]
    if isinstance(result, IdentificationResult):
        own = [f"mode {k}: {doubt}" for k, doubt in enumerate(result.doubts, 1) if doubt]
        (against if len(own) == result.model.n_modes else doubts).extend(own)
    for one in unseen:
        for validation in one.results:
            for output in validation.outputs:
                word = output.verdict.partition(" ")[0]
                if word in _POOR:
                    (against if word == _POOR[0] else doubts).append(
                        f"{one.name}, {output.name}: {output.verdict}"
                    )
    doubts += result.warnings
    reasons = (*against, *doubts)
    if against:
        return Verdict("bad", f"The model cannot be relied on, for {_counted(against, 'reason')}.", reasons)
    if doubts:
        return Verdict("doubt", f"The model can be used with {_counted(doubts, 'reservation')}.", reasons)
    if not unseen:
        return Verdict(
            "doubt",
            "The estimate is sound by its own data. It has not been tried on data that it has not seen: validate it "
            "on another record before it is relied on.",
            (),
        )
    return Verdict("good", "The model can be relied on: it predicts data that it has not seen.", ())


def _counted(reasons: Sequence[str], what: str) -> str:
    return f"one {what}, named below" if len(reasons) == 1 else f"{len(reasons)} {what}s, named below"


def add_verdict(page: Page, verdict: Verdict) -> None:
    """Begin a page with the verdict and what stands behind it."""
    page.warning(verdict.text, tone=verdict.tone)
    for reason in verdict.reasons:
        page.warning(_sentence(reason), tone=verdict.tone)


def add_gates(page: Page, gates: Sequence[Gate]) -> None:
    """Add the table of gates, with a warning for each that did not pass."""
    tones: dict[str, Tone] = {"passed": "good", "doubtful": "doubt", "failed": "bad"}
    page.table(
        ["looked at", "verdict", "found", "expected"],
        [[g.name, Cell(g.verdict, tones.get(g.verdict, "")), g.figure, g.expected] for g in gates],
        "What was looked at in the data before the fit.",
    )
    for gate in gates:
        if gate.remedy:
            page.warning(
                f"{_sentence(gate.name)} {_sentence(gate.figure)}",
                gate.remedy,
                tones.get(gate.verdict, "doubt"),
            )


def _sentence(text: str) -> str:
    text = text.strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '?', '!')) else '.'}" if text else ""
