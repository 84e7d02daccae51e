"""What an experiment came to: its numbers as JSON, and one page that shows them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident import EstimationError, assess_repeatability
from beam_ident.figures.canvas import COLOURS, REFERENCE, axes_grid
from beam_ident.quantities import signed, with_uncertainty
from beam_ident.report.page import Cell, Page
from beam_ident.report.validation import TONES
from beam_ident.report.verdict import Verdict, add_verdict, worst_of
from beam_ros.bags.apparatus import Apparatus, simulated_line
from beam_ros.excitation.plan import plan_excitation
from beam_ros.experiments.plan import Estimation, Plan, PlannedRecording
from beam_ros.experiments.progress_file import files_below
from beam_ros.experiments.quiet_moves import PLAYED, add_moves, rig_that_plays
from beam_ros.experiments.steps import bag_of, estimate_of, scores_of, stored_models, summary_of
from beam_ros.process.checksums import checksum
from beam_ros.process.strict_json import strict_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OUTCOME_FILE = "outcome.json"
REPORT_FILE = "report.html"

_SCHEMA = 1


def write_outcome(plan: Plan, done: Path, place: Path, begun: str) -> dict[str, Any]:
    """Collect what the steps made, and write ``outcome.json`` and ``report.html``.

    Parameters
    ----------
    plan : Plan
    done : Path -- the experiment's folder
    place : Path -- where to write
    begun : str -- when the experiment began, ISO 8601

    Returns
    -------
    dict -- the content of ``outcome.json``: the same for the same plan, however often it was interrupted, but for the
        bags of nodes that ran in real time
    """
    outcome = _outcome(plan, done)
    (place / OUTCOME_FILE).write_text(strict_json(outcome, indent=1), encoding="utf-8")
    _page(plan, outcome, begun, done).write(place / REPORT_FILE)
    return outcome


def read_outcome(folder: Path) -> dict[str, Any]:
    """Return the content of ``outcome.json`` of an experiment that has ended."""
    return dict(json.loads((folder / OUTCOME_FILE).read_text(encoding="utf-8")))


def _outcome(plan: Plan, done: Path) -> dict[str, Any]:
    estimates, repeatability, validations = [], [], []
    for estimation in plan.estimations:
        for fit in estimation.fits:
            summary = summary_of(done / estimate_of(estimation.name, fit.name))
            estimates.append(
                {
                    "estimation": estimation.name,
                    "fit": fit.name,
                    "recordings": list(fit.bags),
                    "report": f"{estimate_of(estimation.name, fit.name)}/report.html",
                    **{key: summary[key] for key in _KEPT},
                }
            )
            validations += [
                {"estimation": estimation.name, "fit": fit.name, "unseen": unseen, "scores": scores}
                for unseen, scores in scores_of(summary).items()
            ]
        if not estimation.together:
            repeatability += _repeatability(plan, estimation, done)
    return {
        "schema": _SCHEMA,
        "plan": plan.name,
        "title": plan.title,
        "digest": plan.digest(),
        "rig": plan.kind.value,
        "over_ros": plan.over_ros,
        "version": version("beam_ros"),
        "recordings": [_described(own, done) for own in (*plan.all_recordings, *_played(plan, done))],
        "verdict": _verdict(estimates),
        "estimates": estimates,
        "repeatability": repeatability,
        "validations": validations,
        "moves": [json.loads((done / own.verdict).read_text(encoding="utf-8")) for own in plan.moves],
    }


_KEPT = ("apparatus", "estimator", "modes", "scores", "converged", "verdict", "warnings", "notes")


def _verdict(estimates: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Judge all models of an experiment together."""
    named = [(f"{own['estimation']} from {own['fit']}", Verdict(**own["verdict"])) for own in estimates]
    return asdict(worst_of(named))


def _played(plan: Plan, done: Path) -> list[PlannedRecording]:
    """Return the recordings of the moves, with the rigs that played them."""
    return [
        PlannedRecording(own.bag(which), own.name, 1.0, 1, own.with_frames, rig_that_plays(own, done, which))
        for own in plan.moves
        for which in PLAYED
    ]


def _described(recording: PlannedRecording, done: Path) -> dict[str, Any]:
    loads = plan_excitation(recording.rig).prediction
    return {
        "name": recording.name,
        "entry": recording.entry,
        "level": recording.level,
        "repetition": recording.repetition,
        "excitation": recording.rig.excitation.kind,
        "duration_s": recording.duration_s,
        "predicted_tip_deflection_m": loads.tip_deflection,
        "predicted_hub_force_n": loads.hub_force,
        "files": {
            path.relative_to(done).as_posix(): checksum(path)
            for path in files_below(done / bag_of(recording.name))
        },
    }


def _repeatability(plan: Plan, estimation: Estimation, done: Path) -> list[dict[str, Any]]:
    """Compare the models of recordings that differ in nothing but their noise."""
    by_place: dict[tuple[str, float], list[str]] = {}
    for own in plan.recordings:
        if own.name in estimation.recordings:
            by_place.setdefault((own.entry, own.level), []).append(own.name)
    found = []
    for (entry, level), bags in by_place.items():
        models = [model for bag in bags for model in stored_models(done / estimate_of(estimation.name, bag))]
        if len(bags) < 2 or len(models) != len(bags):
            continue
        try:
            compared = assess_repeatability(models)
        except EstimationError as err:
            found.append({"estimation": estimation.name, "entry": entry, "level": level, "verdict": str(err)})
            continue
        found.append(
            {
                "estimation": estimation.name,
                "entry": entry,
                "level": level,
                "verdict": compared.verdict,
                "ratio": compared.ratio,
                "p_value": compared.p_value,
                "parameters": [
                    {
                        "name": own.name,
                        "mean": own.mean,
                        "scatter": own.scatter,
                        "stated_sd": float(np.median(own.stated_sd)),
                        "ratio": own.ratio,
                    }
                    for own in compared.parameters
                ],
            }
        )
    return found


def _page(plan: Plan, outcome: Mapping[str, Any], begun: str, done: Path) -> Page:
    simulated = simulated_line(Apparatus(own["apparatus"]) for own in outcome["estimates"])
    page = Page(plan.title, _lead(plan, outcome), simulated)
    page.section("Verdict")
    add_verdict(page, Verdict(**outcome["verdict"]))
    if outcome["estimates"]:
        page.section("Modes")
        for estimation in plan.estimations:
            _modes(page, estimation, outcome)
        first = outcome["estimates"][0]
        drawn = done / Path(first["report"]).parent / "figures"
        for name, caption in _SHOWN.items():
            if (drawn / f"{name}.svg").is_file():
                whose = f"{first['estimation']} from {first['fit']}"
                svg = (drawn / f"{name}.svg").read_text(encoding="utf-8")
                page.drawing(svg, f"{caption} {whose}; each model's own page has its figures.")
    if outcome["validations"]:
        page.section("Validation")
        _validations(page, outcome)
    page.signature()
    page.evidence()
    page.section("Recordings")
    page.table(
        (
            "recording",
            "level",
            "excitation",
            "duration [s]",
            "tip, predicted [mm]",
            "hub force, predicted [N]",
        ),
        [
            (
                own["name"],
                f"{own['level']:g}",
                own["excitation"],
                f"{own['duration_s']:.1f}",
                f"{1e3 * own['predicted_tip_deflection_m']:.2f}",
                f"{own['predicted_hub_force_n']:.2f}",
            )
            for own in outcome["recordings"]
        ],
        "What was recorded, and what the beam was predicted to do before anything moved.",
    )
    _levels(page, plan, outcome)
    _scatter(page, outcome)
    if outcome["moves"]:
        add_moves(page, outcome["moves"], {own.name: f"{own.folder}/report.html" for own in plan.moves})
    page.section("Files")
    page.table(
        ("file", "SHA-256"),
        [(file, digest) for own in outcome["recordings"] for file, digest in own["files"].items()],
        "The bags. Their checksums tell whether a copy is the one that this page speaks of.",
    )
    page.section("Provenance")
    page.table(
        ("what", "value"),
        [
            ("plan", plan.name),
            ("checksum of the plan", outcome["digest"]),
            (
                "rig",
                f"{outcome['rig']}{', over ROS 2' if plan.is_live else ', by the core of the simulator'}",
            ),
            ("begun", begun),
            ("beam_ros", outcome["version"]),
        ],
        "Where the numbers come from. The plan itself lies beside this page as plan.yaml, and every bag describes "
        "its rig in full.",
    )
    return page


_SHOWN = {
    "fit": "Measured and modelled outputs:",
    "response": "The measured response as points and the model's with 95 % bands as lines:",
}


def _validations(page: Page, outcome: Mapping[str, Any]) -> None:
    """Show how every model predicts every recording that it has not seen, and say what is wrong where it does not."""
    rows: list[tuple[str | Cell, ...]] = []
    for own in outcome["validations"]:
        for name, score in own["scores"].items():
            word, _, why = score["verdict"].partition(" ")
            rows.append(
                (
                    f"{own['estimation']} from {own['fit']}, {own['unseen']}: {name}",
                    *(_figure(score[key]) for key in _SCORES),
                    Cell(word, TONES.get(word, "")),
                    Cell(why.rpartition("; ")[2], "" if score["is_independent"] else "doubt"),
                )
            )
    page.table(
        (
            "model, on: output",
            "FIT [%]",
            "of deflection [%]",
            "from rest [%]",
            "residual / noise",
            "verdict",
            "residual and input",
        ),
        rows,
        "Every model on recordings that it has not seen. Near the clamp an output is mostly the hub's motion: the "
        "fit of the deflection, without that, is the sterner test.",
    )


_SCORES = ("fit_percent", "deflection_fit_percent", "fit_from_rest_percent", "residual_over_noise")


def _lead(plan: Plan, outcome: Mapping[str, Any]) -> str:
    doubts = sum(1 for own in outcome["estimates"] for mode in own["modes"] if mode.get("doubt"))
    open_fits = sum(1 for own in outcome["estimates"] if not own["converged"])
    judged = (
        "every fit converged and no mode is doubted"
        if not doubts and not open_fits
        else f"{open_fits} fits did not converge, {doubts} modes are doubted"
    )
    warnings = sum(len(own["warnings"]) for own in outcome["estimates"])
    if warnings:
        judged += f"; {warnings} warnings of the fits stand below"
    counts = ", ".join(f"{key}: {len(outcome[key])}" for key in ("recordings", "estimates", "validations"))
    return f"On the {outcome['rig']} rig, {counts}; {judged if outcome['estimates'] else 'nothing was estimated'}."


_FROM = {
    False: "The name of a recording leads to the whole report of its estimate.",
    True: "All of its recordings are one fit; the word leads to its whole report.",
}


def _modes(page: Page, estimation: Estimation, outcome: Mapping[str, Any]) -> None:
    own = [entry for entry in outcome["estimates"] if entry["estimation"] == estimation.name]
    rows: list[tuple[str | Cell, ...]] = []
    for entry in own:
        for number, mode in enumerate(entry["modes"], start=1):
            rows.append(
                (
                    Cell(entry["fit"], link=entry["report"]),
                    str(mode.get("output", number)),
                    with_uncertainty(mode["frequency_hz"], mode["frequency_sd_hz"] or math.nan),
                    f"{mode['theory_frequency_hz']:.4f}" if "theory_mode" in mode else "–",
                    signed(mode.get("frequency_z") or math.nan),
                    with_uncertainty(
                        100.0 * mode["damping_ratio"], 100.0 * (mode["damping_ratio_sd"] or math.nan)
                    ),
                    f"{100.0 * mode['theory_damping_ratio']:.3f}" if "theory_mode" in mode else "–",
                    Cell(mode["doubt"], "doubt") if mode.get("doubt") else "none",
                )
            )
    page.table(
        ("from", "mode", "frequency [Hz]", "theory [Hz]", "z", "damping ratio [%]", "theory [%]", "doubt"),
        rows,
        f"Modes by the estimator {estimation.estimator} ({estimation.name}), with all known uncertainty as "
        f"standard deviations, beside the theory of the rig. {_FROM[estimation.together]}",
    )
    for entry in own:
        for text in (*entry["warnings"], *entry["notes"]):
            page.warning(f"{entry['fit']}: {text}", tone="doubt")


def _levels(page: Page, plan: Plan, outcome: Mapping[str, Any]) -> None:
    """Show how frequencies and damping ratios change with the amplitude, where an entry has several levels."""
    recorded = {own.name: own for own in plan.recordings}
    levels: dict[str, set[float]] = {}
    for one in plan.recordings:
        levels.setdefault(one.entry, set()).add(one.level)
    shown = [
        (estimation, entry)
        for estimation in plan.estimations
        for entry, found in levels.items()
        if len(found) > 1
        and not estimation.together
        and entry in {recorded[bag].entry for bag in estimation.recordings}
    ]
    if not shown:
        return
    page.section("Linearity over levels")
    for estimation, entry in shown:
        points = [
            (recorded[own["fit"]].level, mode)
            for own in outcome["estimates"]
            if own["estimation"] == estimation.name and recorded[own["fit"]].entry == entry
            for mode in _one_of_each(own["modes"])
        ]
        if points:
            page.figure(
                _level_figure(points),
                f"{estimation.name} from {entry}: every mode over the level of the excitation, with 95 % intervals. "
                "A linear beam shows level lines. A frequency that falls with the amplitude is bending beyond small "
                "angles, a damping ratio that rises is drag of the air.",
                f"Frequency shift and damping ratio of {len({m['theory_mode'] for _, m in points})} modes over the "
                f"level of {entry}.",
            )


def _one_of_each(modes: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return for every mode of theory the nearest of those found that are not in doubt.

    Two that overlap imitate one whose damping depends on the amplitude: only one of them is drawn.
    """
    nearest: dict[int, Mapping[str, Any]] = {}
    for mode in sorted(
        modes, key=lambda mode: -abs(mode["frequency_hz"] - mode.get("theory_frequency_hz", 0.0))
    ):
        if not mode.get("doubt") and "output" not in mode and "theory_mode" in mode:
            nearest[int(mode["theory_mode"])] = mode
    return list(nearest.values())


def _level_figure(points: Sequence[tuple[float, Mapping[str, Any]]]) -> Figure:
    figure, axes = axes_grid(1, 2, (9.0, 3.2))
    shift, damping = axes[0]
    modes = sorted({int(mode["theory_mode"]) for _, mode in points})
    for number, colour in zip(modes, (COLOURS * len(modes))[: len(modes)], strict=True):
        own = [(level, mode) for level, mode in points if mode["theory_mode"] == number]
        first = min(own, key=lambda point: point[0])[1]["frequency_hz"]
        levels = [level for level, _ in own]
        shift.errorbar(
            levels,
            [1e6 * (mode["frequency_hz"] / first - 1.0) for _, mode in own],
            [1.96e6 * mode["frequency_sd_hz"] / first for _, mode in own],
            fmt="o",
            color=colour,
            label=f"mode {number}",
        )
        damping.errorbar(
            levels,
            [100.0 * mode["damping_ratio"] for _, mode in own],
            [196.0 * mode["damping_ratio_sd"] for _, mode in own],
            fmt="o",
            color=colour,
        )
    shift.axhline(0.0, color=REFERENCE, linewidth=0.8)
    shift.set_ylabel("shift of the frequency [1e-6]")
    damping.set_ylabel("damping ratio [%]")
    for axis in (shift, damping):
        axis.set_xlabel("level")
    shift.legend(frameon=False, fontsize=8)
    return figure


def _scatter(page: Page, outcome: Mapping[str, Any]) -> None:
    if not outcome["repeatability"]:
        return
    page.section("Repeatability")
    for own in outcome["repeatability"]:
        good = own["verdict"].startswith("as stated")
        page.warning(
            f"{own['estimation']} from {own['entry']} at level {own['level']:g}: {own['verdict']}",
            tone="good" if good else "doubt",
        )
        if "parameters" not in own:
            continue
        page.table(
            ("parameter", "mean", "scatter", "stated sd", "scatter / stated"),
            [
                (
                    part["name"],
                    f"{part['mean']:.7g}",
                    f"{part['scatter']:.2g}",
                    f"{part['stated_sd']:.2g}",
                    f"{part['ratio']:.2f}",
                )
                for part in own["parameters"]
            ],
            "Natural frequencies [rad/s] and damping ratios over the repetitions: a standard deviation is a promise "
            "about repetition, and the last column is 1 where it is kept.",
        )


def _figure(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.2f}"
