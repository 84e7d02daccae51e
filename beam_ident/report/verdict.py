"""What a report says first: whether the model can be relied on, in words, and why not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from beam_ident.data.records import TimeRecord
from beam_ident.evaluation.assumptions import assumptions
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.noise.scores import InputCorrelation
from beam_ident.quantities import sentence
from beam_ident.report.evidence import Agreement, Unseen
from beam_ident.report.gates import Gate
from beam_ident.report.page import Cell, Page, Tone
from beam_ident.results import Result

_POOR = ("poor", "fair")
_FROM_THE_WORST: tuple[Tone, ...] = ("bad", "doubt", "good")


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


def judge(
    result: Result,
    gates: Sequence[Gate] = (),
    unseen: Sequence[Unseen] = (),
    agreement: Agreement | None = None,
    records: Sequence[TimeRecord] = (),
) -> Verdict:
    """Judge a result by its own end, by its data, by data that it has not seen, and by theory.

    Parameters
    ----------
    result : Result
    gates : sequence of Gate -- of its data
    unseen : sequence of Unseen
    agreement : Agreement, optional -- with theory
    records : sequence of TimeRecord -- that it was estimated from
    """
    against = [] if result.converged else [f"the estimation did not come to its end ({result.reason})"]
    against += [f"the data fail at {gate.name}: {gate.figure}" for gate in gates if gate.verdict == "failed"]
    doubts = [f"doubtful data: {gate.name}, {gate.figure}" for gate in gates if gate.verdict == "doubtful"]
    if isinstance(result, IdentificationResult):
        own = [f"mode {k}: {doubt}" for k, doubt in enumerate(result.doubts, 1) if doubt]
        (against if len(own) == result.model.n_modes else doubts).extend(own)
    tested = [output for one in unseen for validation in one.results for output in validation.outputs]
    for one in unseen:
        for validation in one.results:
            for output in validation.outputs:
                word = output.verdict.partition(" ")[0]
                if word not in _POOR and _follows(output.input_correlation, len(tested)):
                    doubts.append(f"{one.name}, {output.name}: {output.input_correlation.verdict}")
                if word in _POOR:
                    (against if word == _POOR[0] else doubts).append(
                        f"{one.name}, {output.name}: {output.verdict}"
                    )
    doubts += result.warnings
    failing = [own.name for own in assumptions(result, records) if own.verdict == "fails"]
    doubts += [f"intervals rest on what does not hold: {', '.join(failing)}"] * bool(failing)
    if agreement is not None and agreement.is_doubtful:
        doubts.append(agreement.verdict)
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


def worst_of(judged: Sequence[tuple[str, Verdict]]) -> Verdict:
    """Judge several models together, by the worst of them.

    Parameters
    ----------
    judged : sequence of (str, Verdict) -- what each model is called, and the verdict on it
    """
    by_tone = {tone: [own for own in judged if own[1].tone == tone] for tone in _FROM_THE_WORST}
    worst: Tone = next((tone for tone in _FROM_THE_WORST if by_tone[tone]), "doubt")
    models_of: dict[str, list[str]] = {}
    for name, verdict in (own for tone in _FROM_THE_WORST[:2] for own in by_tone[tone]):
        for reason in verdict.reasons or (verdict.text,):
            models_of.setdefault(reason, []).append(name)
    n = len(judged)
    text = {
        "bad": f"{len(by_tone['bad'])} of {n} models cannot be relied on.",
        "doubt": f"{len(by_tone['doubt'])} of {n} models can be used with the reservations below.",
        "good": f"All {n} models can be relied on: they predict data that they have not seen.",
    }[worst]
    if n == 1:
        text = judged[0][1].text
    reasons = tuple(f"{', '.join(names)}: {reason}" for reason, names in models_of.items())
    return Verdict(worst, text if n else "Nothing was estimated.", reasons)


def _follows(own: InputCorrelation, n_tests: int) -> bool:
    """Return whether residuals follow the input, where of ``n_tests`` one fails as rarely as one alone."""
    n_lags = len(own.lags)
    widened = float(ndtri(0.005 / (n_lags * n_tests)) / ndtri(0.005 / n_lags))
    return not own.is_independent and bool(np.max(np.abs(own.correlation)) > widened * own.band)


def _counted(reasons: Sequence[str], what: str) -> str:
    return f"one {what}, named below" if len(reasons) == 1 else f"{len(reasons)} {what}s, named below"


def add_verdict(page: Page, verdict: Verdict) -> None:
    """Begin a page with the verdict and what stands behind it."""
    page.warning(verdict.text, tone=verdict.tone)
    for reason in verdict.reasons:
        page.warning(sentence(reason), tone=verdict.tone)


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
                f"{sentence(gate.name)} {sentence(gate.figure)}",
                gate.remedy,
                tones.get(gate.verdict, "doubt"),
            )
