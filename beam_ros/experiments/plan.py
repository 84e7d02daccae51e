"""The plan of an experiment: what is recorded, what is estimated from it, on what it is validated.

A plan is a YAML file with few keys, all of them checked when it is read: a key that is not known is refused with
the likeliest one, values may carry their unit, names must refer to what the plan has, and every excitation is held
against the limits of the axis and of the beam before anything moves.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from beam_ident import IdentificationError, find_estimator
from beam_ros.errors import ParameterFileError, UsageError, likeliest, suggestion
from beam_ros.excitation.plan import plan_excitation
from beam_ros.excitation.recipes import KINDS
from beam_ros.experiments.quantities import in_si
from beam_ros.experiments.quiet_moves import PLAYED, PlannedMove
from beam_ros.interfaces.graph import RigKind
from beam_ros.interfaces.parameter_files import flatten, read_yaml
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.process.checksums import checksum
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import check_time_of_rig

STRUCTURES = ("auto", "base_motion", "acceleration", "velocity", "force")

_AMPLITUDES = ("acceleration", "max_displacement", "max_velocity", "step_size", "speed")
_MOST_RECORDINGS = 1000
_SEEDS_OF_A_PLAN = 10_000
_MOST_SEED = 200_000
_NAME = "expected letters, digits, - and _, as E1"
_BYTES_PER_SECOND = 250_000
_MOVE_S = 10.0
_CALIBRATION = "calibration"
_ALL = "all"


@dataclass(frozen=True)
class PlannedRecording:
    """One bag of a plan.

    Attributes
    ----------
    name : str -- of the bag: the entry's, with a number behind it where the entry makes several
    entry : str -- its entry under ``recordings``
    level : float -- by which the entry's amplitudes are multiplied
    repetition : int -- counted from 1 at every level
    with_frames : bool -- on the simulator's core: film and track, in place of displacements with noise
    rig : Rig -- with this recording's excitation and seed
    """

    name: str
    entry: str
    level: float
    repetition: int
    with_frames: bool
    rig: Rig

    @property
    def duration_s(self) -> float:
        """How long the hub is busy [s]."""
        from beam_ros.excitation.recipes import recipe_of_rig

        return self.rig.excitation.start_delay + recipe_of_rig(self.rig).total_s


@dataclass(frozen=True)
class Calibration:
    """How pixels become metres.

    Attributes
    ----------
    file : Path or None -- a calibration that exists
    recording : PlannedRecording or None -- else: moves between rests, from whose frames it is made
    """

    file: Path | None
    recording: PlannedRecording | None


@dataclass(frozen=True)
class Fit:
    """One model of an estimation: its name in the folder, and the bags that it is fitted to."""

    name: str
    bags: tuple[str, ...]


@dataclass(frozen=True)
class Estimation:
    """What is estimated from some recordings: a model of every bag, or one of all.

    Attributes
    ----------
    name : str
    recordings : tuple of str -- names of bags
    estimator, structure : str
    modes : int or None -- None: from the data
    together : bool -- all bags are one fit
    """

    name: str
    recordings: tuple[str, ...]
    estimator: str
    structure: str
    modes: int | None
    together: bool

    @property
    def fits(self) -> tuple[Fit, ...]:
        """Every model that is made, with the bags that it is made from."""
        if self.together:
            return (Fit(_ALL, self.recordings),)
        return tuple(Fit(bag, (bag,)) for bag in self.recordings)


@dataclass(frozen=True)
class HoldOut:
    """On which bags the models of an estimation are scored."""

    estimation: str
    recordings: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """A checked plan.

    Attributes
    ----------
    name, title : str
    kind : RigKind
    over_ros : bool -- of a simulated rig: its nodes in real time, in place of the simulator's core
    rig : Rig -- what all recordings share
    calibration : Calibration or None
    recordings : tuple of PlannedRecording -- in their order
    estimations : tuple of Estimation
    validations : tuple of HoldOut
    moves : tuple of PlannedMove
    text : str -- the file as it was read
    """

    name: str
    title: str
    kind: RigKind
    over_ros: bool
    rig: Rig
    calibration: Calibration | None
    recordings: tuple[PlannedRecording, ...]
    estimations: tuple[Estimation, ...]
    validations: tuple[HoldOut, ...]
    moves: tuple[PlannedMove, ...]
    text: str

    @property
    def is_live(self) -> bool:
        """Whether nodes run."""
        return self.over_ros or self.kind is not RigKind.SIMULATED

    def unseen_by(self, estimation: Estimation) -> tuple[str, ...]:
        """Return the recordings that the models of an estimation are validated on, each once."""
        own = [one for one in self.validations if one.estimation == estimation.name]
        return tuple(dict.fromkeys(name for one in own for name in one.recordings))

    @property
    def all_recordings(self) -> tuple[PlannedRecording, ...]:
        """Every bag to record, that of the calibration first."""
        first = self.calibration.recording if self.calibration else None
        return (first, *self.recordings) if first else self.recordings

    @property
    def bytes_needed(self) -> float:
        """What the bags take on the disk, roughly [bytes]."""
        camera, rig = self.rig.camera, self.rig
        frames = camera.width * camera.height * camera.rate if self.is_live and rig.recorder.images else 0.0
        moving_s = sum(
            len(PLAYED) * (own.rig.excitation.dwell + own.rig.excitation.still + _MOVE_S)
            for own in self.moves
        )
        return (moving_s + sum(own.duration_s for own in self.all_recordings)) * (_BYTES_PER_SECOND + frames)

    def digest(self) -> str:
        """Return the checksum of everything that decides what the experiment does."""
        content = dataclasses.asdict(dataclasses.replace(self, rig=None, text=""))  # type: ignore[arg-type]
        if self.calibration and self.calibration.file:
            content["calibration"]["file"] = checksum(self.calibration.file)
        return hashlib.sha256(strict_json(content).encode()).hexdigest()


def packaged_plans() -> dict[str, Path]:
    """Return the plans that come with the suite, by name."""
    folder = Path(str(resources.files("beam_ros"))) / "experiments" / "plans"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def read_plan(
    path: Path,
    *,
    kind: RigKind | None = None,
    over_ros: bool | None = None,
    rig_file: Path | None = None,
    parameters: Sequence[str] = (),
    seed: int | None = None,
) -> Plan:
    """Read and check a plan.

    Parameters
    ----------
    path : Path -- the file; the name of a packaged plan where there is no such file
    kind, over_ros, rig_file, seed : optional -- in place of what the plan says
    parameters : sequence of str -- "name:=value" on top of the rig, before the excitations of the plan

    Raises
    ------
    ParameterFileError
        The file is missing or wrong: an unknown key, a wrong unit, a name that refers to nothing.
    UsageError
        An excitation leaves a limit.
    """
    packaged = packaged_plans()
    if not path.exists() and path.suffix == "" and len(path.parts) == 1:
        if path.name not in packaged:
            raise ParameterFileError(
                f"{path}: no such file, and no packaged plan ({suggestion(path.name, packaged)}); give a YAML file "
                f"or one of {', '.join(packaged)}"
            )
        path = packaged[path.name]
    document = read_yaml(path)
    try:
        return _Reader(path, document, kind, over_ros, rig_file, parameters, seed).plan()
    except ParameterFileError as err:
        raise ParameterFileError(f"{path}: {err}") from err
    except UsageError as err:
        raise UsageError(f"{path}: {err}") from err


class _Reader:
    """Reads one document; every method names the place of what it refuses."""

    def __init__(
        self,
        path: Path,
        document: Any,
        kind: RigKind | None,
        over_ros: bool | None,
        rig_file: Path | None,
        parameters: Sequence[str],
        seed: int | None,
    ) -> None:
        self._path = path
        self._tree = _mapping("the plan", document, _KEYS)
        self._kind, self._over_ros, self._rig_file = kind, over_ros, rig_file
        self._parameters, self._seed = parameters, seed
        self._count = 0

    def plan(self) -> Plan:
        tree = self._tree
        kind = self._kind or RigKind(_word("rig", tree.get("rig", "simulated"), [k.value for k in RigKind]))
        over_ros = (
            _truth("over_ros", tree.get("over_ros", False)) if self._over_ros is None else self._over_ros
        )
        self._base_seed = (
            self._seed if self._seed is not None else _whole("seed", tree.get("seed", 1), 0, _MOST_SEED)
        )
        rig = self._rig()
        if over_ros or kind is not RigKind.SIMULATED:
            check_time_of_rig(kind, rig)
        _refuse_no_port(kind, rig)
        self._common = rig
        calibration = self._calibration()
        recordings = self._recordings(calibration)
        groups = _groups(recordings)
        estimations = self._estimations(groups)
        return Plan(
            name=self._path.stem,
            title=str(tree.get("title", self._path.stem)),
            kind=kind,
            over_ros=over_ros,
            rig=rig,
            calibration=calibration,
            recordings=recordings,
            estimations=estimations,
            validations=self._validations(groups, estimations),
            moves=self._moves(self._rig_of(calibration), groups, estimations),
            text=self._path.read_text(encoding="utf-8"),
        )

    def _rig(self) -> Rig:
        given = self._tree.get("rig_file")
        if given is not None and not isinstance(given, str):
            raise ParameterFileError(f"rig_file is {given!r}: expected the path of a rig file")
        file = self._rig_file or (self._path.parent / given if given else None)
        rig = Rig.from_file(file)
        rig = rig.with_values(self._values("parameters", self._tree.get("parameters", {})))
        return rig.with_texts(self._parameters)

    def _values(self, place: str, tree: Any, prefix: str = "") -> dict[str, object]:
        """Return parameters by their dotted names, in SI; groups may be nested or dotted."""
        if not isinstance(tree, Mapping):
            raise ParameterFileError(
                f"{place} is {tree!r}: expected parameters and values, as {{camera.rate: 200 Hz}}"
            )
        values: dict[str, object] = {}
        for name, value in flatten(tree, prefix):
            known = RIG_PARAMETERS.get(name)
            try:
                values[name] = value if known is None else in_si(known, value)
            except ParameterFileError as err:
                raise ParameterFileError(f"{place}: {err}") from err
        return values

    def _calibration(self) -> Calibration | None:
        if "calibration" not in self._tree:
            return None
        tree = _mapping(_CALIBRATION, self._tree[_CALIBRATION], ("file", "excitation"))
        if len(tree) != 1:
            raise ParameterFileError("calibration: expected either file or excitation; leave one of them out")
        if "file" in tree:
            file = self._path.parent / str(tree["file"])
            if not file.is_file():
                raise ParameterFileError(
                    f"calibration.file: {file}: no such file; give one of `beam calibrate --save`"
                )
            return Calibration(file, None)
        rig = self._excited(_CALIBRATION, self._common, tree["excitation"], 1.0)
        if rig.excitation.kind != "moves":
            raise ParameterFileError(
                f"calibration.excitation.kind is {rig.excitation.kind}: expected moves with rests"
            )
        return Calibration(None, PlannedRecording(_CALIBRATION, _CALIBRATION, 1.0, 1, True, rig))

    def _excited(self, place: str, rig: Rig, tree: Any, level: float) -> Rig:
        """Return the rig with one excitation, whose plan is inside of all limits."""
        values = self._values(place, tree, "excitation.")
        seed = self._base_seed * _SEEDS_OF_A_PLAN + self._count
        self._count += 1
        try:
            rig = rig.with_values({**values, "simulation.seed": seed})
            if level != 1.0:
                kind = KINDS[rig.excitation.kind]
                scaled = [name for name in kind.reads if name in _AMPLITUDES]
                if not scaled or rig.excitation.kind == "moves":
                    raise ParameterFileError(
                        f"an excitation of kind {rig.excitation.kind} has no amplitude; leave levels out"
                    )
                rig = rig.with_values(
                    {f"excitation.{name}": level * rig[f"excitation.{name}"] for name in scaled}
                )
            plan_excitation(rig)
        except ParameterFileError as err:
            raise ParameterFileError(f"{place}: {err}") from err
        except UsageError as err:
            at = "" if level == 1.0 else f" at level {level:g}"
            raise UsageError(f"{place}{at}: {err}") from err
        return rig

    def _rig_of(self, calibration: Calibration | None) -> Rig:
        """Return what all recordings share, with a calibration that exists."""
        if calibration is None or calibration.file is None:
            return self._common
        return self._common.with_values({"tracker.calibration": str(calibration.file.resolve())})

    def _recordings(self, calibration: Calibration | None) -> tuple[PlannedRecording, ...]:
        tree = self._tree.get("recordings")
        if not isinstance(tree, Mapping) or not tree:
            raise ParameterFileError(
                "recordings: expected at least one, as {E1: {excitation: {kind: chirp}}}"
            )
        rig = self._rig_of(calibration)
        recordings: list[PlannedRecording] = []
        for name, entry in tree.items():
            place = f"recordings.{_name('recordings', name)}"
            if name == _CALIBRATION:
                raise ParameterFileError(f"{place}: that name belongs to the calibration; give another one")
            content = _mapping(place, entry, _RECORDING_KEYS)
            levels = _levels(f"{place}.levels", content.get("levels", [1.0]))
            repetitions = _whole(f"{place}.repetitions", content.get("repetitions", 1), 1, _MOST_RECORDINGS)
            with_frames = _truth(f"{place}.frames", content.get("frames", False))
            one = len(levels) * repetitions == 1
            for level in levels:
                for repetition in range(1, repetitions + 1):
                    number = len([own for own in recordings if own.entry == name]) + 1
                    if len(recordings) >= _MOST_RECORDINGS:
                        raise ParameterFileError(
                            f"recordings: more than {_MOST_RECORDINGS} bags; split the plan"
                        )
                    own = self._excited(f"{place}.excitation", rig, content.get("excitation", {}), level)
                    recordings.append(
                        PlannedRecording(
                            name if one else f"{name}-{number}",
                            name,
                            level,
                            repetition,
                            with_frames,
                            own,
                        )
                    )
        names = [own.name for own in recordings]
        doubled = next((name for name in names if names.count(name) > 1), None)
        if doubled is not None:
            raise ParameterFileError(
                f"recordings: two bags would be named {doubled}; rename one of the entries"
            )
        return tuple(recordings)

    def _estimations(self, groups: Mapping[str, tuple[str, ...]]) -> tuple[Estimation, ...]:
        tree = self._tree.get("estimations", {})
        if not isinstance(tree, Mapping):
            raise ParameterFileError(
                f"estimations is {tree!r}: expected names, as {{modal: {{recordings: [E1]}}}}"
            )
        found = []
        for name, entry in tree.items():
            place = f"estimations.{_name('estimations', name)}"
            content = _mapping(place, entry, _ESTIMATION_KEYS)
            estimator = str(content.get("estimator", "modal"))
            try:
                find_estimator(estimator)
            except IdentificationError as err:
                raise ParameterFileError(f"{place}.estimator: {err}") from err
            modes = content.get("modes")
            found.append(
                Estimation(
                    name,
                    _references(place, content, groups),
                    estimator,
                    _word(f"{place}.structure", content.get("structure", "auto"), STRUCTURES),
                    None if modes is None else _whole(f"{place}.modes", modes, 1, 20),
                    _truth(f"{place}.together", content.get("together", False)),
                )
            )
        return tuple(found)

    def _validations(
        self, groups: Mapping[str, tuple[str, ...]], estimations: Sequence[Estimation]
    ) -> tuple[HoldOut, ...]:
        found = []
        known = {own.name: own for own in estimations}
        for number, entry in enumerate(_list("validations", self._tree.get("validations", [])), start=1):
            place = f"validations, entry {number}"
            content = _mapping(place, entry, ("estimation", "recordings"))
            name = _word(f"{place}: estimation", content.get("estimation"), list(known))
            bags = _references(place, content, groups)
            both = sorted(set(bags) & set(known[name].recordings))
            if both:
                raise ParameterFileError(
                    f"{place}: {name} is estimated from {', '.join(both)} itself, which validates nothing; give "
                    "recordings that it has not seen"
                )
            found.append(HoldOut(name, bags))
        return tuple(found)

    def _moves(
        self, rig: Rig, groups: Mapping[str, tuple[str, ...]], estimations: Sequence[Estimation]
    ) -> tuple[PlannedMove, ...]:
        tree = self._tree.get("moves", {})
        if not isinstance(tree, Mapping):
            raise ParameterFileError(
                f"moves is {tree!r}: expected names, as {{quiet: {{estimation: modal, to: 20 mm, aim: 50 um}}}}"
            )
        known = {own.name: own for own in estimations}
        found = []
        for name, entry in tree.items():
            place = f"moves.{_name('moves', name)}"
            content = _mapping(place, entry, _MOVE_KEYS)
            estimation = known[_word(f"{place}.estimation", content.get("estimation"), list(known))]
            if estimation.estimator != "modal" or len(estimation.fits) != 1:
                raise ParameterFileError(
                    f"{place}.estimation: {estimation.name} gives {len(estimation.fits)} models by "
                    f"{estimation.estimator}; expected one modal model: one recording, or together: true"
                )
            rehearsal = content.get("rehearsal")
            values = self._values(place, {f"move_{key}": content.get(key) for key in _PLACES}, "excitation.")
            move_rig = self._moving(place, rig, values)
            moved = move_rig.excitation
            found.append(
                PlannedMove(
                    name,
                    estimation.name,
                    estimation.fits[0].name,
                    None if rehearsal is None else _word(f"{place}.rehearsal", rehearsal, _bags(groups)),
                    moved.move_from,
                    moved.move_to,
                    moved.move_aim,
                    _truth(f"{place}.frames", content.get("frames", False)),
                    move_rig,
                )
            )
            taken = sorted({found[-1].bag(which) for which in PLAYED} & set(groups))
            if taken:
                raise ParameterFileError(f"{place}: its bag {taken[0]} is a recording's; rename one of them")
        return tuple(found)

    def _moving(self, place: str, rig: Rig, values: Mapping[str, object]) -> Rig:
        """Return the rig with the ends of a move and a seed of its own."""
        for name, value in values.items():
            if value is None:
                key = name.removeprefix("excitation.move_")
                raise ParameterFileError(f"{place}.{key} is missing: expected a length, as 20 mm")
        if rig.hub.command_mode == "effort":
            raise ParameterFileError(
                f"{place}: hub.command_mode is effort, and a hub under force follows no command; set hub.command_mode"
            )
        seed = self._base_seed * _SEEDS_OF_A_PLAN + self._count
        self._count += len(PLAYED)
        try:
            own = rig.with_values({**values, "simulation.seed": seed})
        except ParameterFileError as err:
            raise ParameterFileError(f"{place}: {err}") from err
        if own.excitation.move_from == own.excitation.move_to:
            raise ParameterFileError(f"{place} goes nowhere: from and to are the same; give two places")
        return own


_KEYS = (
    "title",
    "rig",
    "over_ros",
    "rig_file",
    "parameters",
    "seed",
    _CALIBRATION,
    "recordings",
    "estimations",
    "validations",
    "moves",
)
_RECORDING_KEYS = ("excitation", "levels", "repetitions", "frames")
_PLACES = ("from", "to", "aim")
_MOVE_KEYS = ("estimation", "rehearsal", *_PLACES, "frames")
_ESTIMATION_KEYS = ("recordings", "estimator", "structure", "modes", "together")


def _bags(groups: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return the names that stand for one bag."""
    return [name for name, bags in groups.items() if bags == (name,)]


def _groups(recordings: Sequence[PlannedRecording]) -> dict[str, tuple[str, ...]]:
    """Return the bags that a name in a plan stands for: one, or all of an entry."""
    groups: dict[str, tuple[str, ...]] = {}
    for own in recordings:
        groups[own.entry] = (*groups.get(own.entry, ()), own.name)
    return {**{own.name: (own.name,) for own in recordings}, **groups}


def _references(
    place: str, content: Mapping[str, Any], groups: Mapping[str, tuple[str, ...]]
) -> tuple[str, ...]:
    names = _list(f"{place}.recordings", content.get("recordings", []))
    if not names:
        raise ParameterFileError(f"{place}.recordings is empty: expected some of {', '.join(groups)}")
    bags = [bag for name in names for bag in groups[_word(f"{place}.recordings", name, groups)]]
    return tuple(dict.fromkeys(bags))


def _mapping(place: str, value: Any, known: Collection[str]) -> dict[str, Any]:
    if value is None:
        value = {}
    if not isinstance(value, Mapping):
        raise ParameterFileError(f"{place} is {value!r}: expected keys of {', '.join(known)}")
    for key in value:
        if key not in known:
            near = likeliest(str(key), known)
            hint = f"did you mean {near}?" if near else f"expected some of {', '.join(known)}"
            raise ParameterFileError(f"{place} has the unknown key {key!r}: {hint}")
    return dict(value)


def _word(place: str, value: Any, known: Collection[str]) -> str:
    if value not in known:
        raise ParameterFileError(f"{place} is {value!r}: {suggestion(str(value), known)}")
    return str(value)


def _truth(place: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ParameterFileError(f"{place} is {value!r}: expected true or false")
    return value


def _whole(place: str, value: Any, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ParameterFileError(f"{place} is {value!r}: expected a whole number from {low} to {high}")
    return value


def _levels(place: str, value: Any) -> list[float]:
    levels = _list(place, value)
    for level in levels:
        if isinstance(level, bool) or not isinstance(level, (int, float)) or not 0.0 < level <= 100.0:
            raise ParameterFileError(f"{place} has {level!r}: expected factors above 0, at most 100")
    return [float(level) for level in levels]


def _list(place: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ParameterFileError(f"{place} is {value!r}: expected a list, as [{value!r}]")
    return value


def _name(place: str, value: Any) -> str:
    if (
        not isinstance(value, str)
        or not value.replace("-", "").replace("_", "").isalnum()
        or not value.isascii()
    ):
        raise ParameterFileError(f"{place} has the name {value!r}: {_NAME}")
    return value


def _refuse_no_port(kind: RigKind, rig: Rig) -> None:
    if kind is RigKind.REAL and rig.lacks_port:
        raise UsageError(
            "rig real needs the controller's port: expected serial.port in the rig file, or "
            "-p serial.port:=/dev/ttyACM0"
        )
