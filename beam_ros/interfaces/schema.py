"""The one schema of the rig's parameters: names, types, units, ranges and what they mean.

The packaged ``config/rig.yaml`` gives every parameter's default; this table says what a value may be. The
nodes declare their parameters from it, the ``beam`` command checks its files with it, and the documentation
prints it, so that ``--params-file`` and ``beam --rig-file`` mean the same. Pure: no ROS.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beam_ros.errors import ParameterFileError

Value = bool | int | float | str | list[float] | list[str]

PACKAGED_RIG = "rig.yaml"
MAX_FACTOR_WITH_IMAGES = 2.0


@dataclass(frozen=True)
class Parameter:
    """What one parameter may be.

    Attributes
    ----------
    name : str -- dotted name, "beam.length"
    kind : str -- bool, int, float, str, floats or strs
    description : str -- one line
    unit : str -- SI, "" where there is none
    minimum, maximum : float or None -- inclusive limits, for every element of a list
    choices : tuple of str -- the allowed words, empty where any text will do
    is_live : bool -- may be changed while a node runs
    """

    name: str
    kind: str
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    is_live: bool = False

    def expectation(self) -> str:
        """Say in words which values are allowed."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        noun = {
            "bool": "true or false",
            "int": "a whole number",
            "float": "a number",
            "str": "text",
            "floats": "a list of numbers",
            "strs": "a list of words",
        }[self.kind]
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        if self.minimum is not None and self.maximum is not None:
            return f"{noun} from {self.minimum:g} to {self.maximum:g}{unit}"
        if self.minimum is not None:
            return f"{noun} of at least {self.minimum:g}{unit}"
        return f"{noun}{f' in{unit}' if unit else ''}"

    def check(self, value: object) -> Value:
        """Return ``value`` in this parameter's type.

        Whole numbers pass for numbers; YAML's bare ``off`` and ``on``, which ROS reads as booleans, pass for the
        words where these are among the choices.

        Raises
        ------
        ParameterFileError
            The type, the word or the range is wrong.
        """
        if self.kind in ("floats", "strs"):
            if isinstance(value, str) or not isinstance(value, Sequence) or len(value) == 0:
                raise self._refusal(value)
            if self.kind == "floats":
                return [self._number(item, value) for item in value]
            if not all(isinstance(item, str) and item for item in value):
                raise self._refusal(value)
            return [str(item) for item in value]
        if self.kind == "float":
            return self._number(value, value)
        if self.kind == "int":
            if isinstance(value, bool) or not isinstance(value, int):
                raise self._refusal(value)
            return int(self._number(value, value))
        if self.kind == "bool":
            if not isinstance(value, bool):
                raise self._refusal(value)
            return value
        if isinstance(value, bool) and self.choices:
            value = "on" if value else "off"
        if not isinstance(value, str) or (self.choices and value not in self.choices):
            raise self._refusal(value)
        return value

    def _number(self, item: object, whole: object) -> float:
        if isinstance(item, bool) or not isinstance(item, (int, float)) or not math.isfinite(item):
            raise self._refusal(whole)
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if not low <= item <= high:
            raise self._refusal(whole)
        return float(item)

    def _refusal(self, value: object) -> ParameterFileError:
        seen = repr(value) if isinstance(value, str) else str(value)
        has_unit = self.unit not in ("", "1")
        unit = f" {self.unit}" if has_unit and isinstance(value, (int, float)) else ""
        remedy = f"; give it in {self.unit}" if has_unit else ""
        return ParameterFileError(f"{self.name} is {seen}{unit}: expected {self.expectation()}{remedy}")


def _group(prefix: str, *parameters: Parameter) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(
            f"{prefix}.{p.name}", p.kind, p.description, p.unit, p.minimum, p.maximum, p.choices, p.is_live
        )
        for p in parameters
    )


RIG_PARAMETERS: dict[str, Parameter] = {
    parameter.name: parameter
    for parameter in (
        *_group(
            "beam",
            Parameter("length", "float", "free length of the strip, clamp to tip", "m", 0.01, 5.0),
            Parameter("width", "float", "width of the strip", "m", 1e-4, 0.5),
            Parameter("thickness", "float", "thickness in the direction of motion", "m", 1e-5, 0.05),
            Parameter("density", "float", "density of the strip", "kg/m^3", 10.0, 25e3),
            Parameter("youngs_modulus", "float", "Young's modulus of the strip", "Pa", 1e6, 2e12),
            Parameter("flexural_rigidity", "float", "EI; 0: E I from the section", "N m^2", 0.0, 1e6),
            Parameter("mass_per_length", "float", "rho; 0: from section and density", "kg/m", 0.0, 1e3),
            Parameter("gravity", "str", "how the beam stands", choices=("off", "upright", "hanging")),
            Parameter("tip_mass", "float", "mass at the tip", "kg", 0.0, 10.0),
            Parameter("tip_inertia", "float", "rotary inertia of the tip mass", "kg m^2", 0.0, 1.0),
            Parameter(
                "clamp_stiffness", "float", "rotary stiffness of the clamp; 0: rigid", "N m/rad", 0.0, 1e9
            ),
            Parameter(
                "damping_ratios", "floats", "of the clamped modes; the last holds above", "1", 0.0, 0.5
            ),
            Parameter("viscous_damping", "float", "per length, relative to the hub", "N s/m^2", 0.0, 1e3),
            Parameter("air_damping", "float", "per length, on the absolute motion", "N s/m^2", 0.0, 1e3),
            Parameter("internal_damping", "float", "Kelvin-Voigt time constant", "s", 0.0, 1.0),
            Parameter("max_root_strain", "float", "predicted bending strain that is refused", "1", 1e-6, 0.1),
            Parameter("modes", "int", "modes that the simulator integrates", "", 1, 20),
        ),
        *_group(
            "markers",
            Parameter("names", "strs", "names in beam/displacement, from the clamp upwards"),
            Parameter("heights", "floats", "heights above the clamp", "m", 0.0, 5.0),
            Parameter("height_uncertainties", "floats", "standard deviations of the heights", "m", 0.0, 0.1),
            Parameter("masses", "floats", "masses of the markers", "kg", 0.0, 1.0),
            Parameter("diameter", "float", "diameter of a marker", "m", 1e-4, 0.1),
        ),
        *_group(
            "hub",
            Parameter("mass", "float", "moving mass of the hub", "kg", 1e-3, 1e3),
            Parameter("travel", "float", "from stop to stop; home is in the middle", "m", 1e-3, 10.0),
            Parameter("max_speed", "float", "limit of the hub's speed", "m/s", 1e-3, 20.0),
            Parameter("max_acceleration", "float", "limit of the hub's acceleration", "m/s^2", 0.01, 1e3),
            Parameter("max_effort", "float", "limit of the force on the hub", "N", 0.01, 1e4),
            Parameter(
                "max_tip_deflection", "float", "predicted tip deflection that is refused", "m", 1e-5, 1.0
            ),
            Parameter("encoder_resolution", "float", "step of the measured position", "m", 1e-12, 1e-3),
            Parameter(
                "command_mode",
                "str",
                "what a set-point or sequence means",
                choices=("acceleration", "velocity", "position", "effort"),
            ),
            Parameter(
                "applied_hold", "str", "between ticks, of the command", choices=("zoh", "linear", "cubic")
            ),
            Parameter("measured_hold", "str", "between ticks, of the position", choices=("linear", "cubic")),
            Parameter("period", "float", "tick of the device", "s", 1e-4, 0.1),
            Parameter("watchdog", "float", "silence until the device stops by itself", "s", 0.05, 5.0),
            Parameter("homing_speed", "float", "speed while homing", "m/s", 1e-3, 1.0),
        ),
        *_group(
            "serial",
            Parameter("port", "str", "device of the motion controller"),
            Parameter("baud", "int", "line speed", "baud", 1200, 12_000_000),
            Parameter("patience", "float", "wait so long for the port to appear", "s", 0.0, 60.0),
        ),
        *_group(
            "emulator",
            Parameter("port_link", "str", "path that links to the pseudo-terminal"),
            Parameter("clock_drift_ppm", "float", "device clock against the host's", "ppm", -1000.0, 1000.0),
        ),
        *_group(
            "camera",
            Parameter("width", "int", "columns of a frame", "px", 16, 16384),
            Parameter("height", "int", "rows of a frame", "px", 16, 16384),
            Parameter("rate", "float", "frames a second", "Hz", 0.1, 10e3),
            Parameter("exposure", "float", "exposure time", "s", 0.0, 1.0),
            Parameter("readout", "float", "first to last row; 0: global shutter", "s", 0.0, 0.1),
            Parameter("stamp", "str", "what a stamp means", choices=("start", "mid", "end", "arrival")),
            Parameter("latency", "float", "known delay of the stamps", "s", -1.0, 1.0),
            Parameter("pixels_per_metre", "float", "scale in the plane of the beam", "px/m", 1.0, 1e7),
            Parameter("origin_u", "float", "column of the beam at rest at home", "px", -1e5, 1e5),
            Parameter("origin_v", "float", "row of the clamp", "px", -1e5, 1e5),
            Parameter("is_mirrored", "bool", "the camera looks from behind"),
            Parameter("contrast", "float", "marker above background", "grey levels", 1.0, 255.0),
            Parameter("background", "float", "level of the background", "grey levels", 0.0, 254.0),
            Parameter("blur", "float", "standard deviation of the optics", "px", 0.0, 20.0),
            Parameter("noise", "float", "standard deviation of a pixel", "grey levels", 0.0, 100.0),
            Parameter("name", "str", "the camera, which calibrations keep; empty: not said"),
            Parameter("focus", "str", "setting of its lens, which calibrations keep; empty: not said"),
        ),
        *_group(
            "tracker",
            Parameter("polarity", "str", "markers against ground", choices=("bright", "dark")),
            Parameter("source", "str", "where frames come from", choices=("topic", "device", "file")),
            Parameter("device", "str", "path, number or address of the camera, for source device"),
            Parameter(
                "device_format", "str", "four characters such as GREY, YUYV, MJPG; empty: the driver's choice"
            ),
            Parameter("sets_exposure", "bool", "set the device to camera.exposure"),
            Parameter("retry_period", "float", "until a device that failed is opened again", "s", 0.05, 60.0),
            Parameter("video", "str", "video file, for source file"),
            Parameter("video_rate", "float", "of the video; 0: as the file says", "Hz", 0.0, 1e6),
            Parameter(
                "refinement",
                "str",
                "what is made of the centre of gravity",
                choices=("none", "radial_symmetry", "disc_model"),
            ),
            Parameter(
                "sigma_floor",
                "float",
                "of a position: what the dots show at rest; 0: perfect discs",
                "px",
                0.0,
                10.0,
            ),
            Parameter(
                "min_contrast", "float", "below which nothing is a marker", "grey levels", 1.0, 65535.0
            ),
            Parameter(
                "averaged_frames", "int", "of a tare or a calibration point", "", 2, 100_000, is_live=True
            ),
            Parameter(
                "drawing_rate", "float", "of beam/shape and tracker/debug_image", "Hz", 0.1, 1e3, is_live=True
            ),
            Parameter("calibration", "str", "calibration file; empty: the nominal scale"),
            Parameter("save_calibration", "str", "file for tracker/fit_calibration to write", is_live=True),
        ),
        *_group(
            "simulation",
            Parameter("images", "bool", "film the beam; else displacements are published directly"),
            Parameter("displacement_noise", "float", "standard deviation without images", "m", 0.0, 0.01),
            Parameter("realistic", "bool", "air drag and large-deflection terms in the beam"),
            Parameter("real_time_factor", "float", "speed of simulated time", "1", 0.01, 20.0),
            Parameter("seed", "int", "of all simulated noise", "", 0, 2**31 - 1),
        ),
        *_group(
            "excitation",
            Parameter(
                "kind",
                "str",
                "signal",
                choices=(
                    "chirp",
                    "linear_chirp",
                    "multisine",
                    "prbs",
                    "step",
                    "doublet",
                    "pulse",
                    "sine",
                    "stepped_sine",
                    "noise",
                    "moves",
                ),
                is_live=True,
            ),
            Parameter("acceleration", "float", "amplitude", "m/s^2", 1e-4, 1e3, is_live=True),
            Parameter(
                "max_displacement", "float", "amplitude at low frequency", "m", 1e-6, 5.0, is_live=True
            ),
            Parameter("start_frequency", "float", "lowest frequency", "Hz", 1e-3, 1e4, is_live=True),
            Parameter("end_frequency", "float", "highest frequency", "Hz", 1e-3, 1e4, is_live=True),
            Parameter("duration", "float", "excitation", "s", 0.01, 3600.0, is_live=True),
            Parameter("still", "float", "still hub afterwards", "s", 0.0, 3600.0, is_live=True),
            Parameter("step_size", "float", "displacement of the step", "m", -1.0, 1.0, is_live=True),
            Parameter("rise_time", "float", "of the step", "s", 1e-3, 60.0, is_live=True),
            Parameter("seed", "int", "of random phases, lines and noise", "", 0, 2**31 - 1, is_live=True),
            Parameter("max_velocity", "float", "amplitude; 0: no ceiling", "m/s", 0.0, 10.0, is_live=True),
            Parameter("max_jerk", "float", "refused above; 0: no limit", "m/s^3", 0.0, 1e9, is_live=True),
            Parameter(
                "line_period",
                "float",
                "of the multisine; 0: near 10 s, a part of the duration",
                "s",
                0.0,
                3600.0,
                is_live=True,
            ),
            Parameter(
                "lines", "str", "of the multisine", choices=("full", "odd", "random_odd"), is_live=True
            ),
            Parameter(
                "detection_group",
                "int",
                "random_odd: one odd line left out of so many",
                "",
                2,
                100,
                is_live=True,
            ),
            Parameter(
                "phases", "str", "of the multisine", choices=("random", "schroeder", "crest"), is_live=True
            ),
            Parameter(
                "drive",
                "str",
                "quantity whose levels prbs, pulse and doublet set",
                choices=("acceleration", "velocity", "position"),
                is_live=True,
            ),
            Parameter(
                "speed", "float", "level in velocity; largest of the moves", "m/s", 1e-6, 10.0, is_live=True
            ),
            Parameter(
                "edge_time", "float", "smooth edges of prbs, pulse, doublet", "s", 0.0, 60.0, is_live=True
            ),
            Parameter("clock_period", "float", "of the prbs", "s", 1e-5, 60.0, is_live=True),
            Parameter("order", "int", "of the prbs: 2^order - 1 clocks", "", 3, 18, is_live=True),
            Parameter("inverse_repeat", "bool", "prbs: each period, then its negative", is_live=True),
            Parameter(
                "high_pass", "float", "prbs: content taken out below this", "Hz", 0.0, 1e3, is_live=True
            ),
            Parameter("width", "float", "of pulse and doublet", "s", 1e-4, 60.0, is_live=True),
            Parameter("gap", "float", "between pulses and doublets of a train", "s", 0.0, 60.0, is_live=True),
            Parameter("frequencies", "floats", "of the stepped sine, in turn", "Hz", 1e-3, 1e4, is_live=True),
            Parameter("settle_cycles", "float", "of the stepped sine", "1", 0.0, 1e5, is_live=True),
            Parameter("measure_cycles", "int", "of the stepped sine", "", 1, 100000, is_live=True),
            Parameter("waypoints", "floats", "of the moves; the last is 0", "m", -1.0, 1.0, is_live=True),
            Parameter(
                "profile",
                "str",
                "of the moves",
                choices=("bounded_jerk", "quintic", "cycloidal"),
                is_live=True,
            ),
            Parameter("jerk", "float", "largest of the moves", "m/s^3", 1e-3, 1e6, is_live=True),
            Parameter("dwell", "float", "rest at every way-point", "s", 0.0, 3600.0, is_live=True),
            Parameter(
                "start_delay", "float", "between handing over and starting", "s", 0.5, 60.0, is_live=True
            ),
        ),
        *_group(
            "recorder",
            Parameter("path", "str", "folder of the bag; empty: runs/<date>", is_live=True),
            Parameter("images", "bool", "record camera frames too", is_live=True),
            Parameter("start_at_launch", "bool", "record from the node's start"),
        ),
        *_group(
            "player",
            Parameter("bag", "str", "folder of the bag"),
            Parameter("rate", "float", "speed of the replay", "1", 0.01, 100.0),
            Parameter("commands", "bool", "also replay what moves an axis"),
        ),
        *_group(
            "identifier",
            Parameter("bag", "str", "folder of the bag", is_live=True),
            Parameter("report", "str", "folder for report and model; empty: beside the bag", is_live=True),
            Parameter("modes", "int", "number of modes; 0: from the data", "", 0, 20, is_live=True),
            Parameter(
                "structure",
                "str",
                "which model fits which input",
                choices=("auto", "base_motion", "acceleration", "velocity", "force"),
                is_live=True,
            ),
        ),
    )
}


def flatten(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values of nested mappings, in their order."""
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flatten(value, f"{name}.")
        else:
            yield name, value


def unknown_parameter(name: str) -> ParameterFileError:
    """Build the error for a name that the schema does not hold, with the nearest one that it does."""
    stem = re.sub(r"_(mm|cm|um|ms|us|hz|khz|gpa|mpa|deg|g)$", "", name, flags=re.IGNORECASE)
    near = [stem] if stem in RIG_PARAMETERS else difflib.get_close_matches(name, RIG_PARAMETERS, 1, 0.5)
    if near:
        known = RIG_PARAMETERS[near[0]]
        hint = f"did you mean {known.name}{f' [{known.unit}]' if known.unit else ''}?"
    else:
        hint = "`beam model --parameters` lists what there is"
    return ParameterFileError(f"unknown parameter {name}: {hint}")


def check_parameters(values: Mapping[str, object]) -> dict[str, Value]:
    """Check dotted names and values against the schema and return them in their types.

    Raises
    ------
    ParameterFileError
        A name is unknown, or a value has a wrong type, word or range.
    """
    checked: dict[str, Value] = {}
    for name, value in values.items():
        if name not in RIG_PARAMETERS:
            raise unknown_parameter(name)
        checked[name] = RIG_PARAMETERS[name].check(value)
    return checked


def check_relations(values: Mapping[str, Value]) -> None:
    """Check what no single parameter can say of itself, on a complete set of values.

    Raises
    ------
    ParameterFileError
        Lists of markers of unequal length, heights out of order or above the tip, a band upside down.
    """
    names = values["markers.names"]
    heights = values["markers.heights"]
    assert isinstance(names, list)
    assert isinstance(heights, list)
    for key in ("markers.heights", "markers.height_uncertainties", "markers.masses"):
        column = values[key]
        assert isinstance(column, list)
        if len(column) != len(names):
            raise ParameterFileError(
                f"{key} has {len(column)} entries for {len(names)} markers: expected one per name in "
                "markers.names; add or remove entries"
            )
    if len(set(names)) != len(names):
        raise ParameterFileError(
            f"markers.names is {names}: expected every name once; rename the doubled one"
        )
    length = values["beam.length"]
    assert isinstance(length, float)
    levels = [float(height) for height in heights]
    if sorted(set(levels)) != levels:
        raise ParameterFileError(
            f"markers.heights is {levels} m: expected heights that rise from the clamp; sort names, heights "
            "and masses together"
        )
    if levels[-1] > length:
        raise ParameterFileError(
            f"markers.heights ends at {levels[-1]:g} m, above the tip at beam.length = {length:g} m: give "
            "heights in metres from the clamp"
        )
    factor = values["simulation.real_time_factor"]
    if values["simulation.images"] and float(factor) > MAX_FACTOR_WITH_IMAGES:  # type: ignore[arg-type]
        raise ParameterFileError(
            f"simulation.real_time_factor is {factor:g} with simulation.images: expected at most "
            f"{MAX_FACTOR_WITH_IMAGES:g}, the most that images over DDS keep up with; switch the images off, or use "
            "`beam simulate`, which needs no real time"
        )
    start, end = values["excitation.start_frequency"], values["excitation.end_frequency"]
    if not float(start) < float(end):  # type: ignore[arg-type]
        raise ParameterFileError(
            f"excitation.start_frequency is {start:g} Hz and excitation.end_frequency {end:g} Hz: expected "
            "the start below the end"
        )


def read_yaml(path: Path) -> Any:
    """Read one YAML file.

    Raises
    ------
    ParameterFileError
        The file is missing, cannot be read, or is no YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as err:
        raise ParameterFileError(f"{path}: no such file; give the path of an existing YAML file") from err
    except (OSError, UnicodeDecodeError) as err:
        raise ParameterFileError(f"{path}: cannot be read as text ({err}); expected a YAML file") from err
    try:
        return YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError) as err:
        place = getattr(err, "problem_mark", None)
        where = f" in line {place.line + 1}" if place is not None else ""
        problem = getattr(err, "problem", None) or str(err).splitlines()[0]
        raise ParameterFileError(f"{path}: no valid YAML{where}: {problem}; mend that line") from err


def parameters_in_file(path: Path) -> dict[str, Value]:
    """Read a ROS parameter file and check what it gives under ``/**``.

    Parameters
    ----------
    path : Path -- a file of the form ``/**: {ros__parameters: {...}}``

    Returns
    -------
    dict -- dotted names and values, only those that the file holds

    Raises
    ------
    ParameterFileError
        The file is missing, has another form, or holds an unknown key, a wrong type, unit or range.
    """
    document = read_yaml(path)
    shape = "expected `/**:` with `ros__parameters:` below it, as in the packaged rig.yaml"
    if not isinstance(document, Mapping) or not document:
        raise ParameterFileError(f"{path}: holds no parameters; {shape}")
    sections = {}
    for node, section in document.items():
        if not isinstance(section, Mapping) or set(section) != {"ros__parameters"}:
            raise ParameterFileError(f"{path}: section {node!r} is no set of ROS parameters; {shape}")
        if not isinstance(section["ros__parameters"], Mapping):
            raise ParameterFileError(f"{path}: section {node!r} has an empty `ros__parameters:`; {shape}")
        sections[str(node)] = section["ros__parameters"]
    if set(sections) != {"/**"}:
        raise ParameterFileError(
            f"{path}: has sections {', '.join(sections)}; a rig file has `/**` alone, so that every node and command "
            f"reads the same: move the others into it; {shape}"
        )
    try:
        return check_parameters(dict(flatten(sections["/**"])))
    except ParameterFileError as err:
        raise ParameterFileError(f"{path}: {err}") from err


def packaged_rig_file() -> Path:
    """Path of the packaged ``rig.yaml``, which holds every parameter's default."""
    return Path(str(resources.files("beam_ros"))) / "config" / PACKAGED_RIG


def packaged_defaults() -> dict[str, Value]:
    """Every parameter's default, read from the packaged file."""
    return parameters_in_file(packaged_rig_file())
