"""The answers of the identification on a fixed set of records, beside those that are stored.

    python -m benchmarks.answers [CASE ...] [--against FILE] [--store FILE] [--limit SECONDS] [--data FOLDER] [--list]

A case is one record of a fixed seed, one call, and what it says: parameters with their standard deviations, the cost,
FIT on the half of the record that the call did not see, kinds of warnings, and processor time.  Beside the stored
answers (``benchmarks/answers.json``) a case is

    same     no parameter moved by more than half of its stored standard deviation
    better   the cost is lower
    worse    the cost is not lower although parameters moved or are others

and the command fails where one is worse.  So a change of method is judged by its answers, whatever it does inside.
The cost is the criterion that the call itself minimises over structures (BIC, which for a given structure is
-2 log-likelihood up to a constant), where it states none ``n log(sum of squares)``.  Records that are not part of the
project (docs/robot-arm.md; FASTER beam of Fortune, Beltempo and Forbes 2019) are read from the folder given by --data
or by BEAM_DATA, and left out without one.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import (
    AxisResult,
    EstimationError,
    InputSignal,
    ModalModel,
    ModalStructure,
    OutputSignal,
    Prior,
    TimeRecord,
    estimate_common_poles,
    estimate_transfer_function,
    fit_free_decay,
    identify,
    identify_axis,
    select_transfer_function,
    validate,
)
from beam_ident.summary import models_of
from beam_ros.offline.loading.experiment import load_experiment
from benchmarks.ident.ailments import AILMENTS
from benchmarks.ident.closed_loop import loop_record
from benchmarks.ident.common_poles import TwoInputsTwoOutputs
from benchmarks.ident.delay import DelayedBeam, DoublePole
from benchmarks.ident.driven_axis import CompliantAxis, DrivenAxis
from benchmarks.ident.forced_beam import DRIFTING, PLAIN, ForcedBeam
from benchmarks.ident.free_decays import ManyPoints
from benchmarks.ident.hammer import Hammer
from benchmarks.ident.multi_input import MultiInput
from benchmarks.ident.noise_as_it_is import FewBits, Outliers, SlowNoise
from benchmarks.ident.orders import second_order, sixth_order
from benchmarks.ident.rig import Rig
from benchmarks.ident.several_records import TwoRecords
from benchmarks.ident.six_modes import SixModeBeam
from benchmarks.ident.stiff_poles import StiffTransferFunction
from benchmarks.ident.supersets import hard_record
from benchmarks.ident.unlike_rig import unlike_rig
from benchmarks.ident_unlike_rig import limited
from benchmarks.real_like import real_like_record
from tests.beam_ident.rao_garnier import benchmark_record

STORED = Path(__file__).with_name("answers.json")
BAGS = Path(__file__).resolve().parents[1] / "bags"
DATA = Path(os.environ.get("BEAM_DATA", ""))
MOVED = 0.5  # standard deviations of a parameter
LOWER = 1e-2  # of the cost, that is of -2 log-likelihood
_FASTER = slice(0, 8192)  # samples of the FASTER beam's closed loop

Parts = tuple[Any, TimeRecord | None]  # what a call takes, and what it does not see
Answer = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One record and one call.

    Attributes
    ----------
    make : callable -- returns what is estimated from, and a record that is not seen
    estimate : callable -- from what ``make`` returns first
    """

    make: Callable[[], Parts]
    estimate: Callable[[Any], Any]

    def answer(self, limit_s: float) -> Answer:
        """Return what the call says; a refusal and a call beyond the limit of processor time say so."""
        seen, unseen = self.make()
        start = time.process_time()
        try:
            with limited(limit_s):
                result = self.estimate(seen)
        except (EstimationError, TimeoutError) as err:
            said = str(err)[:60] if isinstance(err, EstimationError) else "beyond the limit of time"
            return {"seconds": _short(time.process_time() - start), "refused": said}
        return {
            "seconds": _short(time.process_time() - start),
            "cost": _cost(result),
            "fit": _unseen_fits(result, unseen),
            "warnings": sorted({_kind(text) for text in result.warnings}),
            "parameters": _parameters(result),
            "zeros": _zeros(result),
        }


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def _cost(result: Any) -> float:
    """Return the criterion of a result, which is the lower the better the data are explained."""
    if hasattr(result, "bic"):
        return round(float(result.bic), 4)
    chosen = [entry.bic for entry in getattr(result, "orders", ()) if entry.is_chosen]
    if chosen:
        return round(float(chosen[0]), 4)
    if isinstance(result, AxisResult):
        return round(result.n_samples * math.log(result.check.residual_sd**2), 4)
    return round(float(sum(len(own) * math.log(own @ own) for own in result.residuals)), 4)


def _unseen_fits(result: Any, unseen: TimeRecord | None) -> list[float]:
    """Return FIT [%] of every output that a model predicts on what was not seen."""
    if unseen is None:
        return []
    try:
        checks = [validate(model, unseen) for model in models_of(result)]
    except EstimationError:
        return []
    return [round(own.scores.fit_percent, 3) for check in checks for own in check.outputs]


def _kind(warning: str) -> str:
    """Return the beginning of a warning without its figures."""
    return re.sub(r"[-+]?\d[\d.e+-]*", "#", warning)[:40]


def _parameters(result: Any) -> dict[str, list[float]]:
    """Return parameters and standard deviations by names that tell what is compared with what."""
    found: dict[str, list[float]] = {}

    def add(name: str, values: Any, sds: Any) -> None:
        for k, pair in enumerate(zip(np.ravel(values), np.ravel(sds), strict=True)):
            found[f"{name}{k + 1}"] = [_short(float(own)) for own in pair]

    if isinstance(result, AxisResult):
        add("axis", result.estimates, result.standard_deviations)
        return found
    for j, model in enumerate(models_of(result)):
        mark = f"{j}:" if j else ""
        if hasattr(model, "natural_frequencies"):
            add(f"{mark}omega", model.natural_frequencies, model.natural_frequency_sd)
            add(f"{mark}zeta", model.damping_ratios, model.damping_ratio_sd)
            if isinstance(model, ModalModel):
                add(f"{mark}residue", model.residues, model.residue_sd)
            continue
        for path in _paths(model):
            own = f"{mark}{path.input_name}:" if path.input_name != "u" else mark
            omega, zeta, omega_sd, zeta_sd = path.modes()
            add(f"{own}omega", omega, omega_sd)
            add(f"{own}zeta", zeta, zeta_sd)
            add(f"{own}pole", *path.real_poles())
            if path.standard_deviations[-1] > 0.0:
                add(f"{own}delay", path.delay, path.standard_deviations[-1])
    return found


def _paths(model: Any) -> list[Any]:
    return [model.path(name) for name in model.input_names] if hasattr(model, "path") else [model]


def _zeros(result: Any) -> list[list[float]]:
    """Return real and imaginary parts of all zeros in the upper half-plane."""
    paths = [path for model in models_of(result) if hasattr(model, "numerator") for path in _paths(model)]
    zeros = [zero for path in paths for zero in path.zeros if zero.imag >= 0.0]
    return [[_short(float(zero.real)), _short(float(zero.imag))] for zero in zeros]


# What is asked ------------------------------------------------------------------------------------------


def _whole(record: Any) -> Parts:
    return record, None


def _halves(record: TimeRecord) -> Parts:
    times = record.outputs[0].times_s
    middle = 0.5 * float(times[0] + times[-1])
    return record.between(-math.inf, middle), record.between(middle, math.inf)


def _alone(record: TimeRecord, output: str | None = None, drive: str | None = None) -> TimeRecord:
    """Return a record with one output and one input of it."""
    inputs = record.inputs if drive is None else (record.input(drive),)
    return replace(record, inputs=inputs, outputs=(record.output(output or record.output_names[0]),))


def _bag(name: str) -> TimeRecord:
    return load_experiment(BAGS / name, structure="auto").record


def _robot_arm() -> TimeRecord:
    torque, acceleration = np.loadtxt(DATA / "robot_arm" / "robot_arm.dat").T
    drive = InputSignal("u", "", (0.0, 0.008), torque, "linear")
    return TimeRecord((drive,), (OutputSignal("y", "", (0.0, 0.008), acceleration),))


def _faster() -> TimeRecord:
    times, _, force, place, _ = np.loadtxt(DATA / "faster" / "faster.csv", delimiter=",", skiprows=1)[
        _FASTER
    ].T
    clock = (0.0, float(np.mean(np.diff(times))))
    return TimeRecord((InputSignal("u", "", clock, force, "zoh"),), (OutputSignal("y", "", clock, place),))


def _transfer(n_poles: Any, n_zeros: Any, **options: Any) -> Callable[[Any], Any]:
    return lambda record: estimate_transfer_function(record, n_poles, n_zeros, **options)


def cases() -> dict[str, Case]:
    """Return all cases whose records are there, by name: kind of call, kind of record."""
    found: dict[str, Case] = {}

    def add(name: str, make: Callable[[], Any], estimate: Callable[[Any], Any], split: Any = _halves) -> None:
        found[name] = Case(lambda: split(make()), estimate)

    late = {"delay": "estimate"}
    add("tf/rao-garnier", lambda: benchmark_record(0, 10.0), _transfer(4, 1))
    add("tf/second-order", lambda: second_order(0, 5.0), _transfer(2, 1))
    add("tf/sixth-order", lambda: sixth_order(0, 20.0), _transfer(6, 4))
    add("tf/sixth-order-loud", lambda: sixth_order(1, 5.0), _transfer(6, 4))
    add("tf/too-many-poles", lambda: second_order(1, 20.0), _transfer(4, 3))
    add("tf/too-few-poles", lambda: sixth_order(2, 20.0), _transfer(4, 3))
    add("tf/slow-noise", lambda: SlowNoise(0.9, True).record(0), _transfer(4, 1))
    add("tf/outliers", lambda: Outliers(0.05).record(0), _transfer(4, 1))
    add("tf/few-bits", lambda: FewBits(4).record(0), _transfer(4, 1))
    add("tf/loop", lambda: _alone(loop_record(0, 0.9, 10.0), drive="drive"), _transfer(3, 1))
    add("tf/late-beam", lambda: DelayedBeam().record(0), _transfer(6, 4, **late))
    add("tf/late-double-pole", lambda: DoublePole().record(0), _transfer(2, 0, **late), _whole)
    add("tf/stiff", lambda: StiffTransferFunction(100.0, 1e-3, 1000).record(0), _transfer(3, 2), _whole)
    add("tf/two-inputs", lambda: MultiInput(True).record(0), _transfer(4, (2, 3)))
    add("tf/two-inputs-two-denominators", lambda: MultiInput(False).record(0), _transfer((4, 2), (2, 0)))
    add("tf/two-records", lambda: TwoRecords().records(0), _transfer(4, 1, has_offset=True), _whole)
    for seed in range(12):
        n = 2 + seed % 3
        options: dict[str, Any] = {"has_offset": seed % 2 == 1} | (late if seed % 4 == 3 else {})
        add(f"tf/hard-{seed}", partial(hard_record, seed), _transfer(n, n - 1, **options), _whole)
    for seed in range(3):
        add(f"tf/unlike-{seed}", lambda seed=seed: _alone(unlike_rig(seed).first), _transfer(6, 5))
    for seed in range(4):
        add(f"tf/real-like-{seed}", partial(real_like_record, seed, 8192), _transfer(6, 5))
    for seed in range(2):
        add(f"tf/real-like-loop-{seed}", partial(real_like_record, seed, 8192, True), _transfer(6, 5))
    add("tf/real-like-low", partial(real_like_record, 4, 4096), _transfer(4, 3, has_offset=True))
    add("tf/real-like-late", partial(real_like_record, 5, 2048), _transfer(4, 3, **late))
    for name in ("chirp_6s", "multisine", "step", "encoder_noise", "drifting"):
        add(f"tf/bag-{name}", lambda name=name: _alone(_bag(name), "z285"), _transfer(6, 5))
    add("tf/bag-hammer", lambda: _alone(_bag("hammer"), "z285"), _transfer(4, 4, n_integrators=2), _whole)
    add("select/second-order", lambda: second_order(2, 5.0), _choose(range(1, 4)))
    add("select/hard", partial(hard_record, 12), _choose(range(1, 4)), _whole)
    add("select/real-like", partial(real_like_record, 6, 2048), _choose(range(3, 5)))
    for seed in range(4):
        own = _common(2 + seed % 2, 1, has_offset=True)
        add(f"common/hard-{seed}", partial(hard_record, seed, 2), own, _whole)
    add("common/two-inputs", lambda: TwoInputsTwoOutputs().record(0), _common(4, [[2, 3], [1, 0]]))
    add("common/bag-chirp_6s", lambda: _bag("chirp_6s"), _common(4, 4))
    force = ModalStructure("receptance")
    add("modes/rig", lambda: Rig().record(0), identify)
    for name, ailment in AILMENTS.items():
        add(f"modes/rig-{name}", lambda ailment=ailment: ailment(Rig(), 0), identify, _whole)
    add("modes/six", lambda: SixModeBeam().record(0, 20.0), lambda own: identify(own, PLAIN), _whole)
    add("modes/forced-beam", lambda: ForcedBeam().record(0, 20.0), lambda own: identify(own, DRIFTING))
    for seed in (0, 1, 2):
        system = partial(unlike_rig, seed)
        free = {"latency": Prior(0.0, math.inf)}
        add(
            f"modes/unlike-{seed}",
            lambda system=system: (system().first, system().second),
            lambda own, seed=seed, free=free: identify(own, unlike_rig(seed).structure, **free),
            lambda parts: parts,
        )
    add("modes/real-like", partial(real_like_record, 0, 4096), lambda own: identify(own, force))
    add("modes/blows", lambda: Hammer("receptance", 0.1, n_blows=2).records(0), _identify_blows, _whole)
    for name in ("chirp_6s", "drifting"):
        add(f"modes/bag-{name}", partial(_bag, name), lambda own: identify(own, "base_motion"))
    for seed in range(2):
        add(f"decay/points-{seed}", lambda seed=seed: ManyPoints().signals(seed), fit_free_decay, _whole)
    sliding = partial(identify_axis, force="force")
    add("axis/loop", lambda: DrivenAxis(duration_s=10.0).record(0), sliding, _whole)
    disturbed = DrivenAxis(duration_s=10.0, disturbance=2.0, quantum=1e-6)
    add("axis/disturbed", lambda: disturbed.record(0), sliding, _whole)
    add("axis/compliant", lambda: CompliantAxis(duration_s=10.0).record(0), sliding, _whole)
    if (DATA / "robot_arm").is_dir():
        for n, m in ((4, 4), (6, 5)):
            add(f"tf/robot-arm-{n}", _robot_arm, _transfer(n, m, has_free_response=True, has_offset=True))
    if (DATA / "faster").is_dir():
        for n in (4, 6):
            add(f"tf/faster-{n}", _faster, _transfer(n, n - 1, has_offset=True))
    return found


def _choose(n_poles: range) -> Callable[[Any], Any]:
    return lambda record: select_transfer_function(record, n_poles).chosen


def _common(n_poles: int, n_zeros: Any, **options: Any) -> Callable[[Any], Any]:
    return lambda record: estimate_common_poles(record, n_poles, n_zeros, **options)


def _identify_blows(records: Sequence[TimeRecord]) -> Any:
    return identify(records, "receptance")


# How answers compare ------------------------------------------------------------------------------------


def moved(before: Answer, after: Answer) -> float:
    """Return by how many of its standard deviations a parameter moved at most, infinity where there are others."""
    old, new = before.get("parameters", {}), after.get("parameters", {})
    if set(old) != set(new):
        return math.inf
    return max((abs(new[name][0] - old[name][0]) / max(old[name][1], 1e-300) for name in old), default=0.0)


def verdict(before: Answer, after: Answer) -> str:
    """Return how an answer stands beside an earlier one: same, better or worse."""
    if "refused" in before or "refused" in after:
        return (
            "same"
            if "refused" in before and "refused" in after
            else "worse"
            if "cost" in before
            else "better"
        )
    if after["cost"] < before["cost"] - LOWER:
        return "better"
    return "same" if moved(before, after) <= MOVED else "worse"


def main() -> int:
    """Answer all cases and print a line for each; return how many are worse than stored."""
    global DATA
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.answers", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "cases", nargs="*", metavar="CASE", help="beginnings of names; all when none is given"
    )
    parser.add_argument("--against", type=Path, default=STORED, metavar="FILE", help="stored answers")
    parser.add_argument("--store", type=Path, metavar="FILE", help="write these answers, beside others there")
    parser.add_argument("--limit", type=float, default=60.0, help="processor time of one call [s]")
    parser.add_argument("--data", type=Path, default=DATA, help="folder with robot_arm and faster")
    parser.add_argument("--list", action="store_true", help="list the cases")
    arguments = parser.parse_args()
    DATA = arguments.data
    known = cases()
    chosen = [name for name in known if not arguments.cases or name.startswith(tuple(arguments.cases))]
    if arguments.list:
        print("\n".join(known))
        return 0
    stored = _read(arguments.against)
    kept = {} if arguments.store is None else _read(arguments.store)
    ratios, n_worse = [], 0
    heads = ("case", "time [s]", "before", "cost less before's", "moved [sd]", "FIT", "before", "verdict")
    print(f"| {' | '.join(heads)} |\n" + "|---" * len(heads) + "|")
    for name in chosen:
        after, before = known[name].answer(arguments.limit), stored.get(name, {})
        kept[name] = after
        word = verdict(before, after) if before else "new"
        n_worse += word == "worse"
        ratios += [after["seconds"] / before["seconds"]] if before else []
        lower = after.get("cost", math.nan) - before.get("cost", math.nan)
        said = [] if not before else sorted({*after.get("warnings", ())} ^ {*before.get("warnings", ())})
        print(
            f"| {name} | {after['seconds']:.3g} | {before.get('seconds', math.nan):.3g} | {lower:+.4g} "
            f"| {moved(before, after):.2g} | {_fits(after)} | {_fits(before)} | {word} |"
            + "".join(f" [{text}]" for text in said),
            flush=True,
        )
        if arguments.store is not None:
            lines = [f"{json.dumps(name)}: {json.dumps(own)}" for name, own in kept.items()]
            arguments.store.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    if ratios:
        print(f"time over before, median: {np.median(ratios):.2f}; worse: {n_worse} of {len(chosen)}")
    return n_worse


def _fits(answer: Answer) -> str:
    return answer.get("refused", "") or " ".join(f"{own:.2f}" for own in answer.get("fit", ())) or "-"


def _read(path: Path) -> dict[str, Answer]:
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


if __name__ == "__main__":
    raise SystemExit(main())
