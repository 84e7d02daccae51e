"""What the tables and figures are made of: the experiments of the reference work, and what is estimated from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beam_ident import (
    EstimatorSettings,
    IdentificationResult,
    OrderSelection,
    Scores,
    TransferFunctionModel,
    TransferFunctionResult,
    ValidationResult,
    estimate_transfer_function,
    run_estimator,
    select_transfer_function,
    validate,
)
from beam_ros.arrays import FloatArray
from beam_ros.bags.apparatus import simulated_line
from beam_ros.errors import UsageError
from beam_ros.excitation.plan import plan_excitation
from beam_ros.offline.loading.experiment import Experiment, load_experiment
from beam_ros.rig.rig import Rig
from beam_ros.vision.calibration.procedure import CalibrationFit

LOWER_M, UPPER_M = 0.010, 0.225
"""Heights of the two points of the reference work [m]."""

NEEDED = ("E1", "E2", "V2", "S")
OPTIONAL = ("V1",)
DEGREES = (2, 4, 6)
"""Numbers of poles and zeros in the tables of orders: one to three modes."""

_NEAR_M = 0.02

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Point:
    """One of the two measured points: the number in the tables, the marker's name, its height [m]."""

    number: str
    name: str
    height: float

    @property
    def label(self) -> str:
        """Height as it is written in titles."""
        return f"{1e3 * self.height:g} mm"


@dataclass(frozen=True, eq=False)
class AtPoint:
    """What was estimated at one point.

    Attributes
    ----------
    point : Point
    orders : OrderSelection -- on E2
    models : dict of str to TransferFunctionResult
        By the data set E1 or E2, with two poles and zeros for each mode that all points together show in E2.
    """

    point: Point
    orders: OrderSelection
    models: Mapping[str, TransferFunctionResult]

    @property
    def left_out(self) -> int:
        """How many poles BIC would have taken beyond those of the models: they stay in the residuals."""
        chosen = next(entry for entry in self.orders.table if entry.is_chosen)
        return max(chosen.n_poles - self.models["E2"].model.n_poles, 0)

    @property
    def transfer_functions(self) -> dict[str, TransferFunctionModel]:
        """The models by their data sets."""
        return {name: result.model for name, result in self.models.items()}


@dataclass(frozen=True, eq=False)
class ThesisData:
    """Experiments and estimates.

    Attributes
    ----------
    experiments : dict of str to Experiment -- E1, E2, V1 (where there is one), V2, S
    rigs : dict of str to Rig -- those they were recorded on
    calibration : CalibrationFit or None -- from the calibration's bag, where there is one
    modal : dict of str to IdentificationResult -- all markers at once, by data set
    points : tuple of AtPoint -- the lower one and the upper one
    validations : dict of (str, str, str) to ValidationResult
        By the point's name ("" for all at once), the data set of the model, and the record.
    simulated : Simulated -- the chirp E1 by theory
    """

    experiments: Mapping[str, Experiment]
    rigs: Mapping[str, Rig]
    calibration: CalibrationFit | None
    modal: Mapping[str, IdentificationResult]
    points: tuple[AtPoint, ...]
    validations: Mapping[tuple[str, str, str], ValidationResult]
    simulated: Simulated

    @property
    def apparatus(self) -> str:
        """What must stand under the title where no beam was measured; empty where all data are measured."""
        return simulated_line(own.apparatus for own in self.experiments.values())


@dataclass(frozen=True, eq=False)
class Simulated:
    """The chirp E1 as the model of the beam answers it, without noise.

    Attributes
    ----------
    times_s : ndarray, shape (n,) -- from the start of the sequence [s]
    hub : ndarray, shape (n,) -- [m]
    displacements : ndarray, shape (n, 2) -- at the two points [m]
    offset_s : float -- start of the sequence on the clock of E1's record [s]
    """

    times_s: FloatArray
    hub: FloatArray
    displacements: FloatArray
    offset_s: float


def load_bags(folder: Path) -> dict[str, Path]:
    """Find the bags of the reference work in a folder, or in its folder ``bags``.

    Raises
    ------
    UsageError
        One that is needed is not there.
    """
    root = folder / "bags" if (folder / "bags").is_dir() else folder
    found = {name: root / name for name in (*NEEDED, *OPTIONAL, "calibration") if (root / name).exists()}
    missing = [name for name in NEEDED if name not in found]
    if missing:
        raise UsageError(
            f"{folder}: has no {', '.join(missing)}: expected the bags {', '.join(NEEDED)}, and if there are any V1 "
            "and calibration; name them so, or leave --bags out to have them recorded"
        )
    return found


def estimate_all(
    bags: Mapping[str, Path], calibration: CalibrationFit | None, progress: Progress
) -> ThesisData:
    """Estimate everything that the tables and figures need.

    Parameters
    ----------
    bags : mapping of str to Path -- of ``load_bags``
    calibration : CalibrationFit or None
    progress : callable -- called with a phrase and the share done

    Raises
    ------
    BagError, UsageError, IdentificationError
    """
    experiments, rigs = {}, {}
    for name in (*NEEDED, *OPTIONAL):
        if name in bags:
            experiments[name] = load_experiment(bags[name], structure="base_motion")
            rigs[name] = _rig_of(experiments[name])
    lower, upper = (_point(experiments["E1"], rigs["E1"], number, height) for number, height in _HEIGHTS)
    modal: dict[str, IdentificationResult] = {}
    for number, name in enumerate(("E1", "E2")):
        progress(f"modes from {name}", 0.1 * number)
        own = experiments[name]
        found = run_estimator("modal", own.record, EstimatorSettings("base_motion", None, own.clock_rate))
        assert isinstance(found, IdentificationResult)
        modal[name] = found
    points = []
    for number, point in enumerate((lower, upper)):
        progress(f"orders at {point.label}", 0.2 + 0.35 * number)
        points.append(_at_point(point, experiments, modal))
    progress("validation", 0.9)
    validations = {}
    for name, result in modal.items():
        for unseen in _unseen(experiments, name):
            validations["", name, unseen] = validate(result.model, experiments[unseen].record)
    for at in points:
        for name, fitted in at.models.items():
            for unseen in _unseen(experiments, name):
                validations[at.point.name, name, unseen] = validate(fitted.model, experiments[unseen].record)
    return ThesisData(
        experiments,
        rigs,
        calibration,
        modal,
        tuple(points),
        validations,
        _simulated(experiments["E1"], lower, upper),
    )


def hub_alone_fit_percent(data: ThesisData, name: str, unseen: str) -> float:
    """Return the fit of a model without a beam, the hub's own position, to an output of a record [%]."""
    record = data.experiments[unseen].record
    output, drive = record.output(name), record.inputs[0]
    seen = output.is_valid
    measured = output.values[seen]
    left = measured - np.interp(output.times_s[seen], drive.times_s, drive.values)
    return Scores.of(measured, left - np.mean(left)).fit_percent


_HEIGHTS = (("10", LOWER_M), ("225", UPPER_M))


def _rig_of(experiment: Experiment) -> Rig:
    if experiment.rig is None:
        raise UsageError(
            f"{experiment.path}: does not say which rig it was recorded on, and the tables need to know; expected "
            "excitation/info in the bag: record with this suite"
        )
    return experiment.rig


def _unseen(experiments: Mapping[str, Experiment], name: str) -> list[str]:
    return [other for other in ("V1", "V2", "S") if other in experiments and other != name]


def _point(experiment: Experiment, rig: Rig, number: str, height: float) -> Point:
    """Return the marker nearest to a height of the reference work."""
    markers = rig.markers
    names = experiment.record.output_names
    near = min(zip(markers.heights, markers.names, strict=True), key=lambda own: abs(own[0] - height))
    if abs(near[0] - height) > _NEAR_M or near[1] not in names:
        raise UsageError(
            f"{experiment.path}: no marker within {1e3 * _NEAR_M:g} mm of {1e3 * height:g} mm was seen; the "
            f"reference work's points are at {1e3 * LOWER_M:g} and {1e3 * UPPER_M:g} mm: give bags with markers there"
        )
    return Point(number, near[1], near[0])


def _at_point(
    point: Point, experiments: Mapping[str, Experiment], modal: Mapping[str, IdentificationResult]
) -> AtPoint:
    """Make the table of orders on E2, and estimate models from E1 and E2."""
    options: dict[str, Any] = {"has_offset": True, "has_ramp": True, "n_integrators": 0}

    def known(name: str) -> dict[str, Any]:
        # The delay of the camera is known best from all points at once.
        return {**options, "delay": max(modal[name].model.latency, 0.0)}

    record = experiments["E2"].record.select((point.name,))
    orders = select_transfer_function(record, DEGREES, DEGREES, n_starts=2, **known("E2"))
    # A single point may ask for more, where a mode is felt that it cannot place: what all points see decides.
    degree = 2 * modal["E2"].model.n_modes
    models = {}
    for name in ("E1", "E2"):
        own = experiments[name].record.select((point.name,))
        result = estimate_transfer_function(own, degree, degree, **known(name))
        assert isinstance(result, TransferFunctionResult)  # of one input
        models[name] = result
    return AtPoint(point, orders, models)


def _simulated(experiment: Experiment, *points: Point) -> Simulated:
    """Run the chirp through the model of the beam."""
    if "start_ns" not in experiment.info:
        raise UsageError(
            f"{experiment.path}: excitation/info does not say when the sequence began, so that no simulation can be "
            "laid over it; record with this suite"
        )
    rig = _rig_of(experiment)
    sampled, model = plan_excitation(rig).sampled, rig.beam_model()
    states = model.motion_stepper(sampled.period_s).run(sampled.accelerations)
    heights = [point.height for point in points]
    accelerations = np.append(sampled.accelerations, 0.0)
    hub = sampled.positions
    deflections = (
        states[:, : model.n_modes] @ model.shape(heights).T
        - accelerations[:, None] * model.residual_terms(heights)[None, :]
    )
    return Simulated(
        np.arange(len(hub), dtype=np.float64) * sampled.period_s,
        hub,
        hub[:, None] + deflections,
        (int(experiment.info["start_ns"]) - experiment.record.start_ns) * 1e-9,
    )
