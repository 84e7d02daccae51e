"""Moves that a plan shapes from its own models, plays, and holds against what was predicted of them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident import ModalModel, restore
from beam_ident.figures.canvas import COLOURS, MEASURED, REFERENCE, axes_grid
from beam_ident.report.page import Page
from beam_ros.arrays import FloatArray
from beam_ros.offline.swing_after import swing_after
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLAYED = ("unshaped", "shaped")
"""What is played of every move, in this order."""
_RIG_FILES = {"unshaped": "unshaped.yaml", "shaped": "move.yaml"}
_TWO_SIDED = 1.96


@dataclass(frozen=True)
class PlannedMove:
    """A move of a plan.

    Attributes
    ----------
    name : str
    estimation, fit : str -- whose model it is shaped from
    rehearsal : str or None -- a bag of quick moves: how the hub follows, and what large swings do
    start, end : float -- from home [m]
    aim : float -- largest swing afterwards [m]
    with_frames : bool -- on the simulator's core: film and track it
    rig : Rig
    """

    name: str
    estimation: str
    fit: str
    rehearsal: str | None
    start: float
    end: float
    aim: float
    with_frames: bool
    rig: Rig

    def bag(self, which: str) -> str:
        """Return the name of the bag in which one of ``PLAYED`` is recorded."""
        return f"{self.name}-{which}"

    @property
    def folder(self) -> str:
        """Where the shaped move lies in the experiment's folder."""
        return f"moves/{self.name}"

    @property
    def verdict(self) -> str:
        """Where what was measured lies, beside what was predicted."""
        return f"verdicts/{self.name}.json"


def rig_that_plays(move: PlannedMove, done: Path, which: str) -> Rig:
    """Return the rig with a move of ``PLAYED`` as its excitation, as the step that shaped it left it."""
    seed = move.rig.simulation.seed + PLAYED.index(which)
    return Rig.from_file(done / move.folder / _RIG_FILES[which]).with_values({"simulation.seed": seed})


def verdict_on(move: PlannedMove, done: Path, bags: Mapping[str, Path]) -> dict[str, Any]:
    """Return what was measured of a move beside what was predicted, in plain numbers (SI).

    Parameters
    ----------
    move : PlannedMove
    done : Path -- the experiment's folder
    bags : mapping of str to Path -- the bag of every one of ``PLAYED``
    """
    predicted = json.loads((done / move.folder / "move.json").read_text(encoding="utf-8"))
    model = restore(json.loads((done / move.folder / "model.json").read_text(encoding="utf-8"))["model"])
    assert isinstance(model, ModalModel)
    seen = {which: swing_after(bags[which], model) for which in PLAYED}
    shaped = seen["shaped"]
    unshaped = rig_that_plays(move, done, "unshaped").excitation
    outputs = []
    for k, name in enumerate(shaped.output_names):
        own = predicted["chosen"]["swings"][name]
        noise = _TWO_SIDED * float(np.linalg.norm(shaped.mode_sds[k]))
        low, high = max(0.0, own["low"] - noise), own["high"] + noise
        outputs.append(
            {
                "name": name,
                "predicted": own["median"],
                "low": low,
                "high": high,
                "measured": float(shaped.swings[k]),
                "unshaped": float(seen["unshaped"].swings[k]),
                "is_inside": bool(low <= shaped.swings[k] <= high),
            }
        )
    worst = max(outputs, key=lambda own: own["predicted"])
    return {
        "name": move.name,
        "aim": move.aim,
        "duration_s": predicted["chosen"]["duration_s"],
        "unshaped_duration_s": unshaped.command_period * len(unshaped.command),
        "lower_bound_s": predicted["lower_bound_s"],
        "move": predicted["chosen"]["name"],
        "probability_above_aim": predicted["chosen"]["probability_above_aim"],
        "keeps_aim_by_prediction": predicted["keeps_aim"],
        "needed": predicted["needed"],
        "outputs": outputs,
        "worst": worst["name"],
        "is_below_aim": max(own["measured"] for own in outputs) <= move.aim,
        "reduction": worst["unshaped"] / worst["measured"],
        "swings": {
            which: [own.times_s.tolist(), own.deflections[:, own.output_names.index(worst["name"])].tolist()]
            for which, own in seen.items()
        },
    }


def add_moves(page: Page, verdicts: Sequence[Mapping[str, Any]], links: Mapping[str, str]) -> None:
    """Add the section of the quiet moves to an experiment's page.

    Parameters
    ----------
    page : Page
    verdicts : sequence of mapping -- of ``verdict_on``
    links : mapping of str to str -- the page of every move, by its name
    """
    page.section("Moves that do not ring")
    for own in verdicts:
        page.warning(
            _sentence(own), tone="good" if own["is_below_aim"] and _is_as_predicted(own) else "doubt"
        )
        page.table(
            ("marker", "predicted [um]", "95 % interval [um]", "measured [um]", "inside", "unshaped [um]"),
            [
                (
                    row["name"],
                    f"{1e6 * row['predicted']:.3g}",
                    f"{1e6 * row['low']:.3g} to {1e6 * row['high']:.3g}",
                    f"{1e6 * row['measured']:.3g}",
                    "yes" if row["is_inside"] else "no",
                    f"{1e6 * row['unshaped']:.3g}",
                )
                for row in own["outputs"]
            ],
            f"Swing after {own['name']} at every marker: predicted before it was played (with what the camera's "
            "noise adds to the interval), measured, and measured after an S-curve of "
            f"{own['unshaped_duration_s']:.3f} s, which is as long, or longer where the limits ask for it.",
        )
        row = next(row for row in own["outputs"] if row["name"] == own["worst"])
        page.figure(
            swings_figure(own["swings"], (row["low"], row["high"]), own["aim"]),
            f"{own['worst']} around the end of both moves, and the shaped one alone. Grey is the predicted interval, "
            "dashed the aim.",
            f"Swing after {own['name']}, unshaped and shaped.",
        )
        page.link(f"How {own['name']} was chosen", links[own["name"]])


def _is_as_predicted(own: Mapping[str, Any]) -> bool:
    return bool(next(row for row in own["outputs"] if row["name"] == own["worst"])["is_inside"])


def _sentence(own: Mapping[str, Any]) -> str:
    row = next(row for row in own["outputs"] if row["name"] == own["worst"])
    kept = "keeps" if own["is_below_aim"] else "misses"
    inside = "inside" if row["is_inside"] else "outside of"
    chosen = "" if own["keeps_aim_by_prediction"] else f" It was the best there is: {own['needed']}."
    return (
        f"{own['name']}, {own['move']} in {own['duration_s']:.3f} s, {kept} its aim of {1e6 * own['aim']:.3g} um: "
        f"{own['worst']} swings by {1e6 * row['measured']:.3g} um, {inside} the predicted {1e6 * row['low']:.3g} to "
        f"{1e6 * row['high']:.3g} um, and by {own['reduction']:.0f} times as much unshaped.{chosen}"
    )


def write_verdict(content: Mapping[str, Any], path: Path) -> str:
    """Write what ``verdict_on`` returned; return it in a phrase."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(strict_json(content, indent=1), encoding="utf-8")
    return _sentence(content)


def swings_figure(
    swings: Mapping[str, Sequence[Sequence[float]]], interval: tuple[float, float], aim: float
) -> Figure:
    """Draw measured swings after moves: all in one picture, and beside it the quiet one alone.

    Parameters
    ----------
    swings : mapping of str to (sequence of float, sequence of float)
        By the move's name, the quiet one last: since the end of the command [s], and there [m].
    interval : (float, float) -- 95 % of what was predicted of the quiet one's swing [m]
    aim : float -- [m]
    """
    figure, axes = axes_grid(1, 2, (9.0, 3.4))
    whole, close = axes[0]
    rows: list[tuple[str, FloatArray, FloatArray]] = [
        (name, np.array(times), np.array(deflections)) for name, (times, deflections) in swings.items()
    ]
    for (name, times, deflections), colour in zip(rows, COLOURS, strict=False):
        whole.plot(times, 1e3 * deflections, color=colour, linewidth=0.9, label=name)
    name, times, deflections = rows[-1]
    after = times >= 0.0
    close.plot(
        times[after],
        1e6 * deflections[after],
        ".",
        markersize=2.5,
        color=COLOURS[len(swings) - 1],
        label=f"{name}, measured",
    )
    for sign in (-1.0, 1.0):
        is_named = sign > 0.0
        close.axhspan(
            1e6 * sign * interval[0],
            1e6 * sign * interval[1],
            color=MEASURED,
            alpha=0.25,
            linewidth=0.0,
            label="predicted, 95 %" if is_named else None,
        )
        close.axhline(
            1e6 * sign * aim,
            color=REFERENCE,
            linestyle="--",
            linewidth=0.9,
            label="aim" if is_named else None,
        )
    # Room above the aim, where nothing is drawn, for the names.
    highest = 1e6 * max(aim, interval[1], float(np.max(np.abs(deflections[after]), initial=0.0)))
    close.set_ylim(-1.1 * highest, 1.35 * highest)
    whole.set_ylabel("from its place of rest [mm]")
    close.set_ylabel("from its place of rest [um]")
    for axis in (whole, close):
        axis.set_xlabel("time since the end of the command [s]")
    whole.legend(frameon=False, fontsize=9, loc="lower right")
    close.legend(frameon=False, fontsize=8, loc="upper center", ncols=3, columnspacing=1.2)
    return figure
