"""A shaped move for people: the table at the terminal, the numbers as JSON, the page with its pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beam_ident import ModalModel
from beam_ident.amplitude.curves import AmplitudeCurves, amplitude_curves
from beam_ident.amplitude.free_stretches import free_decay_of
from beam_ident.quantities import sentence
from beam_ident.report.page import Page
from beam_ident.shaping.choice import JudgedMove
from beam_ident.shaping.known_beam import AxisErrors
from beam_ros.bags.errors import BagError
from beam_ros.errors import UsageError
from beam_ros.excitation.shaping import RigMove, unshaped_beside
from beam_ros.offline.axis_following import following_of_bag
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.process.strict_json import strict_json
from beam_ros.reporting.comparison import stored_models
from beam_ros.reporting.move_figures import command_figure, insensitivity_figure

RIG_FILE, UNSHAPED_FILE, REPORT_FILE, JSON_FILE, MODEL_FILE = (
    "move.yaml",
    "unshaped.yaml",
    "report.html",
    "move.json",
    "model.json",
)


@dataclass(frozen=True, eq=False)
class KnownModel:
    """What a ``model.json`` says that a move is shaped from.

    Attributes
    ----------
    model : ModalModel
    curves : AmplitudeCurves or None -- over amplitude, where they were asked for
    axis : AxisErrors or None -- how the hub followed in the bag of the identification, where that is found
    """

    model: ModalModel
    curves: AmplitudeCurves | None
    axis: AxisErrors | None


def known_model(file: Path, rehearsal: Path | None = None) -> KnownModel:
    """Read what ``beam identify`` wrote, and what a rehearsal shows beside it.

    Parameters
    ----------
    file : Path -- ``model.json``, or the folder that holds one
    rehearsal : Path, optional
        A bag of quick moves with rests: how the hub follows there, and curves over the amplitude of its decays.

    Raises
    ------
    UsageError
        The file holds no modal model.
    BagError
        The rehearsal cannot be read.
    """
    models = [model for model in stored_models(file) if isinstance(model, ModalModel)]
    if not models:
        raise UsageError(f"{file}: holds no modal model; expected one of `beam identify --estimator modal`")
    file = file / "model.json" if file.is_dir() else file
    document = json.loads(file.read_text(encoding="utf-8"))
    summary = document.get("summary", {}) if isinstance(document, Mapping) else {}
    stored = summary.get("amplitude")
    curves = AmplitudeCurves.from_dict(stored) if stored else None
    axis = _following(file, [Path(bag) for bag in summary.get("bags", [])])
    if rehearsal is not None:
        shown = following_of_bag(rehearsal)
        axis = axis.joined(shown) if axis else shown
        curves = amplitude_curves(free_decay_of(load_experiment(rehearsal).record))
    return KnownModel(models[0], curves, axis)


def _following(file: Path, bags: list[Path]) -> AxisErrors | None:
    """Return how the hub followed in the first bag that is still there, or beside the model."""
    for bag in (*bags, file.parent / "bag", file.parent.parent / "bag"):
        if bag.exists():
            try:
                return following_of_bag(bag)
            except BagError:
                continue
    return None


def describe_move(found: RigMove) -> dict[str, Any]:
    """Return a chosen move in plain numbers (SI)."""
    choice = found.choice
    return {
        "schema": 1,
        "from": choice.task.start,
        "to": choice.task.end,
        "aim": choice.aim,
        "source": found.source,
        "keeps_aim": choice.keeps_aim,
        "needed": choice.needed,
        "lower_bound_s": choice.lower_bound_s,
        "axis": {"lag": choice.beam.axis.lag, "scatters": [list(one) for one in choice.beam.axis.scatters]},
        "relative_frequency_sd": choice.beam.frequency_sd.tolist(),
        "chosen": _trial(choice.chosen),
        "shapers": [_trial(trial) for trial in choice.shapers],
        "others": [_trial(trial) for trial in choice.others],
        "notes": list(found.notes),
    }


def _trial(trial: JudgedMove) -> dict[str, Any]:
    low, high = trial.residual.interval
    return {
        "name": trial.move.name,
        "duration_s": trial.move.duration_s,
        "probability_above_aim": trial.probability,
        "objection": trial.objection,
        "swings": {
            name: {"median": median, "low": own_low, "high": own_high}
            for name, median, own_low, own_high in zip(
                trial.residual.output_names,
                trial.residual.median.tolist(),
                low.tolist(),
                high.tolist(),
                strict=True,
            )
        },
    }


def format_move(content: Mapping[str, Any]) -> str:
    """Format what ``describe_move`` returned for a terminal."""
    chosen = content["chosen"]
    bound = content["lower_bound_s"]
    lines = [
        f"from {1e3 * content['from']:g} to {1e3 * content['to']:g} mm, by {content['source']}; aim: a swing below "
        f"{1e6 * content['aim']:g} um",
        "",
        f"{chosen['name']}, {chosen['duration_s']:.3f} s"
        + (f"; no move could be shorter than {bound:.3f} s" if bound else ""),
        f"probability that the aim is exceeded: {_percent(chosen['probability_above_aim'])}",
        "",
        "output   predicted swing [um]   95 % interval [um]",
        *(
            f"{name:<8} {_um(own['median']):>20}   {_um(own['low'])} to {_um(own['high'])}"
            for name, own in chosen["swings"].items()
        ),
        "",
        f"{'beside it':<40} {'duration':>9} {'swing':>10} {'95 % interval':>22} {'above aim':>10}",
        *(_row(trial) for trial in (*content["shapers"], *content["others"])),
    ]
    if not content["keeps_aim"]:
        lines += ["", f"no move keeps the aim: {content['needed']}"]
    for note in content["notes"]:
        lines += ["", f"note: {note}"]
    return "\n".join(lines)


def _worst(trial: Mapping[str, Any]) -> Mapping[str, float]:
    found: Mapping[str, float] = max(trial["swings"].values(), key=lambda own: own["median"])
    return found


def _row(trial: Mapping[str, Any]) -> str:
    own = _worst(trial)
    interval = f"{_um(own['low'])} to {_um(own['high'])}"
    words = f"  {trial['objection']}" if trial["objection"] else ""
    return (
        f"{trial['name']:<40} {trial['duration_s']:>7.3f} s {_um(own['median']):>7} um {interval:>19} um "
        f"{_percent(trial['probability_above_aim']):>10}{words}"
    )


def _um(metres: float) -> str:
    """Return a length in micrometres with three digits, and none behind the point where it is long."""
    text = f"{1e6 * metres:.3g}"
    return text if "e+" not in text else f"{float(text):.0f}"


def _percent(share: float) -> str:
    return "< 0.1 %" if share < 0.001 else f"{100.0 * share:.1f} %"


def write_move(found: RigMove, folder: Path) -> None:
    """Write the rigs that play a move and the unshaped one beside it, numbers, model and page into a new folder."""
    folder.mkdir(parents=True, exist_ok=True)
    found.rig.write(folder / RIG_FILE)
    unshaped_beside(found).write(folder / UNSHAPED_FILE)
    stored = {"schema": 1, "model": found.choice.beam.model.to_dict()}
    (folder / MODEL_FILE).write_text(strict_json(stored, indent=1), encoding="utf-8")
    content = describe_move(found)
    (folder / JSON_FILE).write_text(strict_json(content, indent=1), encoding="utf-8")
    choice = found.choice
    lead = (
        f"From {1e3 * choice.task.start:g} to {1e3 * choice.task.end:g} mm in "
        f"{choice.chosen.move.duration_s:.3f} s, by {found.source}. "
    )
    lead += (
        f"The swing exceeds {1e6 * choice.aim:g} um with a probability of {_percent(choice.chosen.probability)}."
        if choice.keeps_aim
        else f"No move keeps {1e6 * choice.aim:g} um: {choice.needed}."
    )
    page = Page("A move that does not ring", lead)
    add_move(page, found)
    page.write(folder / REPORT_FILE)


def add_move(page: Page, found: RigMove) -> None:
    """Add tables and pictures of a move to a page."""
    content = describe_move(found)
    for note in found.notes:
        page.warning(sentence(note), tone="doubt")
    beside = [trial for trial in content["shapers"] if trial["name"] != content["chosen"]["name"]]
    page.table(
        ("move", "duration [s]", "swing [um]", "95 % interval [um]", "above the aim", "limits"),
        [
            (
                trial["name"],
                f"{trial['duration_s']:.3f}",
                _um(_worst(trial)["median"]),
                f"{_um(_worst(trial)['low'])} to {_um(_worst(trial)['high'])}",
                _percent(trial["probability_above_aim"]),
                trial["objection"] or "kept",
            )
            for trial in (content["chosen"], *beside, *content["others"])
        ],
        "The chosen move first, then the shortest that each shaper allows, then what stands for comparison: the "
        "S-curve within the same limits, the same as long as the chosen move, filters, and shapers for the frequency "
        "of theory with damping ratios from textbooks. Swings are those of the output that swings most.",
    )
    page.figure(
        insensitivity_figure(found.choice),
        "What each move leaves where all frequencies lie elsewhere than identified. The grey band is the interval in "
        "which they lie with 95 %: within it a curve must stay below the aim.",
        "Swing over the error of the frequencies.",
    )
    page.figure(
        command_figure(found.choice),
        "The command of the chosen move beside the S-curve within the same limits.",
        "Acceleration, speed and way over time.",
    )
