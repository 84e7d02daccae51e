"""Do moves leave what was predicted? Simulated rigs are identified, moves are shaped from that, played and filmed.

    python -m benchmarks.quiet_moves [--games N] [--first SEED] [--air share] [--json FILE] [--beside]

Every game draws a strip, a way and an aim. A faint chirp gives the modes, a rehearsal of quick moves the axis and the
decays. Then the strip grows warmer or colder by what the budget allows, the move is shaped, and the shaped and the
unshaped move of the same length are played on the realistic rig. A game whose aim no move keeps is counted, not
played. With --beside, every game plays the moves of others, too: the S-curve, shapers of textbook values, and the
shaper that a printer's calibration chooses from the same chirp.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from beam_ident.errors import IdentificationError
from beam_ident.shaping.choice import UNSHAPED
from beam_ident.shaping.command import Move, convolved
from beam_ident.shaping.residual import predict_residual
from beam_ros.errors import RigError
from beam_ros.excitation.shaping import MOVED_SD, MoveOrder, RigMove, shape_for_rig, with_move
from beam_ros.offline.identification import identification_of_bags, write_models
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.offline.simulation import simulate
from beam_ros.offline.swing_after import swing_after
from beam_ros.reporting.shaping import known_model
from beam_ros.rig.rig import Rig
from benchmarks.printer_shapers import (
    ASSUMED_DAMPING,
    half_power_damping,
    published_choice,
    spectrum_of,
)

WITHOUT_AIR = {"simulation.drag_coefficient": 0.0, "simulation.large_deflections": False}
CHIRP = {
    "excitation.duration": 10.0,
    "excitation.still": 5.0,
    "excitation.acceleration": 0.4,
    "excitation.max_displacement": 0.002,
}
REHEARSAL = {
    "excitation.kind": "moves",
    "excitation.waypoints": [0.015, 0.0],
    "excitation.acceleration": 3.0,
    "excitation.speed": 0.5,
    "excitation.jerk": 240.0,
    "excitation.dwell": 0.6,
    "excitation.still": 7.0,
}
NO_LIMITS = {"hub.max_tip_deflection": 0.2, "beam.max_root_strain": 0.1}
"""Of the unshaped move, which a real beam would not be let make."""
REST = {"excitation.dwell": 2.0, "excitation.still": 0.1}
FASTER = 10.0
"""By which time runs faster for the printer's calibration: the first mode lies where one of a printer does, at 44 Hz.

The second one then lies above the band that it looks at. That helps it: it weighs accelerations, and would shape the
second mode, which swings ten times less far.
"""
PRINTER_ASSUMED = f"printer's, damping {ASSUMED_DAMPING:g}"
PRINTER_MEASURED = "printer's, damping of the peak"


def game(seed: int, air: bool, folder: Path, *, with_others: bool = False) -> dict[str, Any]:
    """Play one game; return its figures (SI)."""
    rng = np.random.default_rng(seed)
    rig = Rig.from_file().with_values(
        {
            "simulation.preset": "realistic",
            **({} if air else WITHOUT_AIR),
            "simulation.images": False,
            "beam.length": float(rng.uniform(0.29, 0.34)),
            "beam.thickness": float(rng.uniform(0.45e-3, 0.6e-3)),
            "beam.damping_ratios": [float(rng.uniform(0.003, 0.008))],
            "simulation.seed": seed,
        }
    )
    start, end = _way(rng)
    if with_others:  # from home: what others leave of a way to the start would still swing
        start, end = 0.0, end - start
    aim = float(np.exp(rng.uniform(np.log(5e-5), np.log(5e-4))))
    order = MoveOrder(start, end, aim)
    row: dict[str, Any] = {"seed": seed, "air": air, "from": start, "to": end, "aim": aim}
    simulate(rig.with_values(CHIRP), folder / "chirp")
    rehearsed = _softened(rig.with_values(REHEARSAL))
    simulate(rehearsed, folder / "rehearsal")
    write_models(identification_of_bags(folder / "chirp"), folder / "model.json")
    known = known_model(folder / "model.json", folder / "rehearsal")
    begun = time.process_time()
    found = shape_for_rig(rig, order, known.model, curves=known.curves, axis=known.axis)
    choice = found.choice
    row |= {
        "shaped_in_s": time.process_time() - begun,
        "move": choice.chosen.move.name,
        "keeps_aim": choice.keeps_aim,
        "duration_s": choice.chosen.move.duration_s,
        "lower_bound_s": choice.lower_bound_s,
        "probability": choice.chosen.probability,
        "durations": {trial.move.name.split(" for")[0]: _duration(trial) for trial in choice.shapers},
    }
    if not choice.keeps_aim:
        return row | {"needed": choice.needed}
    warmer = 1.0 + MOVED_SD[0] * float(rng.standard_normal())
    later = {"beam.youngs_modulus": rig.beam.youngs_modulus * warmer**2, "simulation.seed": seed + 10**6}
    row |= _played(found, later, folder)
    if with_others:
        row["beside"] = _beside(found, later, folder)
    return row


def _way(rng: np.random.Generator) -> tuple[float, float]:
    """Draw a way of 5 to 45 mm, half of them from home."""
    length = float(rng.uniform(0.005, 0.045)) * float(rng.choice([-1.0, 1.0]))
    if rng.random() < 0.5:
        return 0.0, length
    low, high = max(-0.045, -0.045 - length), min(0.045, 0.045 - length)
    start = float(rng.uniform(low, high))
    return start, start + length


def _softened(rig: Rig) -> Rig:
    """Return a rehearsal that the gate lets pass: shorter where the beam would bend too far."""
    from beam_ros.errors import UsageError
    from beam_ros.excitation.plan import plan_excitation

    for way in (0.015, 0.012, 0.009, 0.006):
        rig = rig.with_values({"excitation.waypoints": [way, 0.0]})
        try:
            plan_excitation(rig)
        except UsageError:
            continue
        return rig
    return rig


def _duration(trial: Any) -> float | None:
    return trial.move.duration_s if trial.is_fine else None


def _played(found: RigMove, later: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Play the shaped move, and the unshaped one of the same length where the gate lets it pass."""
    choice, model = found.choice, found.choice.beam.model
    simulate(found.rig.with_values({**later, **REST}), folder / "shaped")
    shaped = swing_after(folder / "shaped", model)
    residual = predict_residual(choice.chosen.move, choice.beam, shaped.mode_sds)
    low, high = residual.interval
    row: dict[str, Any] = {
        "outputs": list(shaped.output_names),
        "measured": shaped.swings.tolist(),
        "median": residual.median.tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "is_inside": ((low <= shaped.swings) & (shaped.swings <= high)).tolist(),
        "is_below_aim": bool(np.max(shaped.swings) <= choice.aim),
        "place": float(np.mean(residual.swings[:, residual.worst] < shaped.swings[residual.worst])),
    }
    plain = next(trial for trial in choice.others if trial.move.name == f"{UNSHAPED}, as long")
    order = MoveOrder(choice.task.start, choice.task.end, choice.aim)
    unshaped_rig = with_move(found.rig, plain.move, order).with_values({**later, **REST, **NO_LIMITS})
    simulate(unshaped_rig, folder / "unshaped")
    unshaped = swing_after(folder / "unshaped", model)
    return row | {
        "is_unshaped_allowed": not plain.objection,
        "unshaped": unshaped.swings.tolist(),
        "reduction": float(np.max(unshaped.swings) / np.max(shaped.swings)),
    }


def _beside(found: RigMove, later: dict[str, Any], folder: Path) -> list[dict[str, Any]]:
    """Play what others would, and say what the same beam and the film of each move say of it."""
    choice = found.choice
    order = MoveOrder(choice.task.start, choice.task.end, choice.aim)
    rows = []
    for number, move in enumerate((choice.chosen.move, *_moves_of_others(found, folder / "chirp"))):
        bag = folder / f"beside{number}"
        simulate(with_move(found.rig, move, order).with_values({**later, **REST, **NO_LIMITS}), bag)
        residual = predict_residual(move, choice.beam)
        low, high = residual.interval
        rows.append(
            {
                "name": ("chosen", "ZV, as identified", move.name)[min(number, 2)],
                "duration_s": move.duration_s,
                "predicted": float(np.max(residual.median)),
                "low": float(low[residual.worst]),
                "high": float(high[residual.worst]),
                "measured": float(np.max(swing_after(bag, choice.beam.model).swings)),
            }
        )
    return rows


def _moves_of_others(found: RigMove, chirp: Path) -> list[Move]:
    """Return the best ZV, the S-curve, as quick and as long, filters, textbook shapers, and the printer's."""
    base = found.choice.others[0].move
    moves = [trial.move for trial in (found.choice.shapers[0], *found.choice.others)]
    record = load_experiment(chirp).record
    tip = record.outputs[-1]
    rate_hz = 1.0 / float(np.median(np.diff(tip.times_s)))
    spectrum = spectrum_of(np.where(np.isfinite(tip.values), tip.values, 0.0), rate_hz, FASTER)
    for name, zeta in (
        (PRINTER_ASSUMED, ASSUMED_DAMPING),
        (PRINTER_MEASURED, half_power_damping(spectrum)),
    ):
        chosen = published_choice(spectrum, zeta)
        print(f"{name} {zeta:.3g}: {chosen.name} at {chosen.frequency_hz / FASTER:.3f} Hz", file=sys.stderr)
        times, amplitudes = chosen.impulses
        moves.append(convolved(base, FASTER * times, amplitudes, name))
    return moves


def side_by_side(rows: list[dict[str, Any]]) -> str:
    """Return the moves of all games beside each other, as medians."""
    games = [row for row in rows if "beside" in row]
    lines = [f"{'move':<44}{'duration':>10}{'predicted':>12}{'measured':>12}{'/ aim':>10}  aim kept"]
    for number, first in enumerate(games[0]["beside"] if games else []):
        own = [row["beside"][number] for row in games]
        aims = np.array([row["aim"] for row in games])
        measured = np.array([each["measured"] for each in own])
        duration, predicted = (
            float(np.median([each[key] for each in own])) for key in ("duration_s", "predicted")
        )
        lines.append(
            f"{first['name']:<44}{duration:>8.3f} s{1e6 * predicted:>9.3g} um{1e6 * np.median(measured):>9.3g} um"
            f"{np.median(measured / aims):>10.3g}  {int(np.sum(measured <= aims))} of {len(games)}"
        )
    return "\n".join(lines)


def summary(rows: list[dict[str, Any]]) -> str:
    """Say what the games came to."""
    played = [row for row in rows if "measured" in row]
    refused = [row for row in rows if row.get("keeps_aim") is False]
    failed = [row for row in rows if "error" in row]
    lines = [
        f"{len(rows)} games: {len(played)} played, {len(refused)} without a move that keeps the aim, "
        f"{len(failed)} failed"
    ]
    for name, chosen in _groups(played):
        if not chosen:
            continue
        worst = [int(np.argmax(row["median"])) for row in chosen]
        inside = sum(row["is_inside"][k] for row, k in zip(chosen, worst, strict=True))
        every = [one for row in chosen for one in row["is_inside"]]
        kept = sum(row["is_below_aim"] for row in chosen)
        reductions = [row["reduction"] for row in chosen if "reduction" in row]
        ratios = [row["measured"][k] / row["median"][k] for row, k in zip(chosen, worst, strict=True)]
        lines.append(
            f"{name}: {len(chosen)} moves; measured inside the 95 % interval: {inside} "
            f"({100 * inside / len(chosen):.1f} %; over all markers {100 * np.mean(every):.1f} %); aim kept: {kept} "
            f"({100 * kept / len(chosen):.1f} %); measured / predicted median: {np.median(ratios):.2f}; reduction "
            f"against the unshaped move as long: median {np.median(reductions):.0f}"
        )
    return "\n".join(lines)


def _groups(rows: list[dict[str, Any]]) -> list[tuple[str, list[dict[str, Any]]]]:
    return [
        ("all", rows),
        ("without air", [row for row in rows if not row["air"]]),
        ("with air", [row for row in rows if row["air"]]),
    ]


def play(
    games: int,
    first: int,
    air: float,
    show: Callable[[dict[str, Any]], None],
    *,
    with_others: bool = False,
) -> list[dict[str, Any]]:
    """Play games one after the other; a game that fails is a row that says so."""
    rows = []
    for number in range(games):
        seed, is_air = first + number, (number + 0.5) / games < air if air not in (0.0, 1.0) else bool(air)
        with tempfile.TemporaryDirectory() as folder:
            try:
                row = game(seed, is_air, Path(folder), with_others=with_others)
            except (IdentificationError, RigError) as err:
                row = {"seed": seed, "air": is_air, "error": str(err)}
        rows.append(row)
        show(row)
    return rows


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--games", type=int, default=200)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument(
        "--air", type=float, default=0.5, help="share of the games with air and large deflections"
    )
    parser.add_argument("--json", type=Path)
    parser.add_argument("--beside", action="store_true", help="play the moves of others in every game, too")
    arguments = parser.parse_args()
    rows = play(
        arguments.games,
        arguments.first,
        arguments.air,
        lambda row: print(json.dumps(row), flush=True),
        with_others=arguments.beside,
    )
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    print(summary(rows))
    if arguments.beside:
        print(side_by_side(rows))


if __name__ == "__main__":
    main()
