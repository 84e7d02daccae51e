"""Which fields of which topics are input and outputs: read from the command line, from parameters and from YAML.

A signal is written ``TOPIC:FIELD`` with options behind commas, ``/imu:linear_acceleration.x,sd=0.02``; in YAML as
that text, or as a mapping with the same words. In a file of columns it is a column, ``tip_mm,sd=2e-5``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beam_ident.numerics.piecewise import HOLDS
from beam_ros.errors import ParameterFileError, UsageError, suggestion
from beam_ros.files.units import INPUT_KINDS as KIND_OF_INPUT_UNIT
from beam_ros.files.units import OUTPUT_KINDS as KIND_OF_OUTPUT_UNIT
from beam_ros.files.units import Unit, find_unit, known_units
from beam_ros.signals.field_paths import FieldPath

POWERS = {"position": 0, "velocity": 1, "acceleration": 2}
"""What an input of motion is, and how often its position is differentiated to become it."""

SENSORS = {"receptance": 0, "mobility": 1, "accelerance": 2}
"""What an output is, by the response it shows of a force: how often displacement is differentiated to become it."""

FORCE = "force"
INPUT_KINDS = (*POWERS, FORCE)
UNITS = {"position": "m", "velocity": "m/s", "acceleration": "m/s^2", FORCE: "N"}
SENSOR_UNITS = {"receptance": "m", "mobility": "m/s", "accelerance": "m/s^2"}

_WORDS = (
    # part of a field's name, what an input is then, what an output is
    ("accel", "acceleration", "accelerance"),
    ("veloc", "velocity", "mobility"),
    ("twist", "velocity", "mobility"),
    ("effort", FORCE, ""),
    ("force", FORCE, ""),
    ("wrench", FORCE, ""),
)


@dataclass(frozen=True)
class SignalSource:
    """One field of one topic, or one column of a file, and what is known of the sensor behind it.

    Attributes
    ----------
    topic, field : str -- no topic: the field is a column of a file
    name : str -- of the signal; empty: from topic and field
    kind : str -- position, velocity, acceleration or force of an input, receptance, mobility or accelerance of an
        output; empty: by the unit, or by the field's name
    unit : str -- in which the field is, "mm"; empty: the SI unit of its kind
    delay : float -- by how much stamps are late, as far as that is known [s]
    exposure : float -- of an output: every value is the mean over this long [s]
    low_pass : float -- of an output: where its sensor shows 71 % of what is there [Hz]; 0: nowhere
    order : int -- of that low-pass, 1 or 2
    sd : float or None -- standard deviation of the noise, where it is known, in SI units
    hold : str -- of an input: what it does between samples; empty: see ``held``
    scale : float -- SI units in one unit of the field, or a factor behind ``unit``; negative for a sensor that looks
        against +x

    Raises
    ------
    UsageError
        A unit that is not known, or of another kind.
    """

    topic: str
    field: str
    name: str = ""
    kind: str = ""
    unit: str = ""
    delay: float = 0.0
    exposure: float = 0.0
    low_pass: float = 0.0
    order: int = 1
    sd: float | None = None
    hold: str = ""
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not self.unit:
            return
        if find_unit(self.unit) is None:
            raise UsageError(
                f"{self.title}: the unit {self.unit!r} is not known; expected one of {known_units()}"
            )
        meant = {KIND_OF_INPUT_UNIT.get(self._unit.si), KIND_OF_OUTPUT_UNIT.get(self._unit.si)}
        if self.kind and self._unit.si in KIND_OF_OUTPUT_UNIT and self.kind not in meant:
            raise UsageError(
                f"{self.title}: kind is {self.kind}, but the unit {self.unit} is of another; mend one"
            )

    @property
    def _unit(self) -> Unit:
        return find_unit(self.unit) or Unit("")

    @property
    def title(self) -> str:
        """Name of the signal."""
        return self.name or (f"{self.topic.strip('/')}:{self.field}" if self.topic else self.field)

    @property
    def input_kind(self) -> str:
        """What it is as an input: given, by its unit, or by the field's name."""
        by_name = next((word for part, word, _ in _WORDS if part in self.field), "position")
        return self.kind or KIND_OF_INPUT_UNIT.get(self._unit.si, by_name)

    @property
    def output_kind(self) -> str:
        """What it is as an output: given, by its unit, or by the field's name."""
        by_name = next((word for part, _, word in _WORDS if word and part in self.field), "receptance")
        return self.kind or KIND_OF_OUTPUT_UNIT.get(self._unit.si, by_name)

    @property
    def factor(self) -> float:
        """What the field's values are multiplied with."""
        return self.scale * self._unit.factor

    @property
    def input_unit(self) -> str:
        """Unit of an input, in which its samples are after scaling."""
        own = self._unit.si
        return own if KIND_OF_INPUT_UNIT.get(own) == self.input_kind else UNITS[self.input_kind]

    @property
    def output_unit(self) -> str:
        """Unit of an output, in which its samples are after scaling."""
        own = self._unit.si
        return own if KIND_OF_OUTPUT_UNIT.get(own) == self.output_kind else SENSOR_UNITS[self.output_kind]

    @property
    def held(self) -> str:
        """What an input does between samples, where nobody said: a force is held, a measured motion is smooth."""
        return self.hold or ("zoh" if self.input_kind == FORCE else "cubic")

    @staticmethod
    def of(text: str, is_input: bool) -> SignalSource:
        """Read ``TOPIC:FIELD[,option=value ...]``, or a column of a file in the place of topic and field.

        Raises
        ------
        UsageError
            It is none, an option is unknown, or a value is wrong.
        """
        # Names of joints stand in brackets and may hold commas.
        place, *options = re.split(r",(?![^\[]*\])", text.strip())
        topic, separator, field = place.partition(":")
        if not separator:
            topic, field = "", topic
        if not field.strip() or (separator and not topic.strip()) or field.startswith("/"):
            raise UsageError(
                f"{text!r} names no field of a topic; expected TOPIC:FIELD with options behind commas, as "
                "/imu:linear_acceleration.x,kind=accelerance, or the column of a file, as tip_mm"
            )
        values: dict[str, object] = {}
        for option in options:
            word, separator, value = option.partition("=")
            if not separator:
                raise UsageError(f"{text!r}: {option!r} sets nothing; expected option=value")
            values[word.strip()] = value.strip()
        return _source(text, topic.strip(), field.strip(), values, is_input)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types, without what is as usual."""
        plain = SignalSource(self.topic, self.field)
        return {name: value for name, value in vars(self).items() if value != getattr(plain, name)} | {
            "topic": self.topic,
            "field": self.field,
        }


@dataclass(frozen=True)
class Signals:
    """Input and outputs of an identification; where one is left out, the rig's own stands in.

    Attributes
    ----------
    drive : SignalSource or None -- None: the rig's hub
    outputs : tuple of SignalSource -- empty: the rig's markers
    """

    drive: SignalSource | None = None
    outputs: tuple[SignalSource, ...] = ()

    def __post_init__(self) -> None:
        titles = [own.title for own in (self.drive, *self.outputs) if own is not None]
        for title in titles:
            if titles.count(title) > 1:
                raise UsageError(
                    f"two signals have the name {title!r}; give one another with ,name=... behind its field"
                )

    def require_topics(self) -> None:
        """Raise UsageError for a column of a file among signals of a bag."""
        for own in (self.drive, *self.outputs):
            if own is not None and not own.topic:
                raise UsageError(
                    f"{own.field!r} names no field of a topic; expected TOPIC:FIELD of a bag, as "
                    "/imu:linear_acceleration.x"
                )

    def __bool__(self) -> bool:
        """Whether any signal is named."""
        return self.drive is not None or bool(self.outputs)

    @staticmethod
    def of(drive: str = "", outputs: Sequence[str] = (), file: Path | None = None) -> Signals:
        """Read signals from texts, and from a file what no text gives.

        Parameters
        ----------
        drive : str -- the input's text, or empty
        outputs : sequence of str -- texts of the outputs
        file : Path, optional -- YAML with ``input`` and ``outputs``

        Raises
        ------
        UsageError, ParameterFileError
            A text or the file is wrong.
        """
        kept = Signals() if file is None else _from_file(file)
        return Signals(
            SignalSource.of(drive, is_input=True) if drive else kept.drive,
            tuple(SignalSource.of(text, is_input=False) for text in outputs) or kept.outputs,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain types, as the YAML file has them."""
        return {
            **({"input": self.drive.to_dict()} if self.drive else {}),
            **({"outputs": [own.to_dict() for own in self.outputs]} if self.outputs else {}),
        }


def _from_file(path: Path) -> Signals:
    try:
        content = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as err:
        raise ParameterFileError(f"{path}: cannot be read ({err}); give a YAML file of signals") from err
    except YAMLError as err:
        raise ParameterFileError(f"{path}: is no YAML ({err}); mend it") from err
    if not isinstance(content, Mapping):
        raise ParameterFileError(f"{path}: holds {content!r}; expected `input` and a list of `outputs`")
    for key in content:
        if key not in ("input", "outputs"):
            raise ParameterFileError(
                f"{path}: unknown key {key!r}; {suggestion(str(key), ('input', 'outputs'))}"
            )
    outputs = content.get("outputs") or []
    if not isinstance(outputs, list):
        raise ParameterFileError(
            f"{path}: outputs is {outputs!r}; expected a list, a line with a dash for each"
        )
    try:
        drive = content.get("input")
        return Signals(
            None if drive is None else _entry(drive, is_input=True),
            tuple(_entry(one, is_input=False) for one in outputs),
        )
    except UsageError as err:
        raise ParameterFileError(f"{path}: {err}") from err


def _entry(entry: object, is_input: bool) -> SignalSource:
    if isinstance(entry, str):
        return SignalSource.of(entry, is_input)
    if not isinstance(entry, Mapping) or not {"topic", "field"} <= set(entry):
        raise UsageError(f"{entry!r} is no signal; expected TOPIC:FIELD, or a mapping with topic and field")
    rest = {str(key): value for key, value in entry.items() if key not in ("topic", "field")}
    return _source(str(dict(entry)), str(entry["topic"]), str(entry["field"]), rest, is_input)


def _source(text: str, topic: str, field: str, values: Mapping[str, object], is_input: bool) -> SignalSource:
    if topic:
        FieldPath.of(field)
    readers = _INPUT_OPTIONS if is_input else _OUTPUT_OPTIONS
    read: dict[str, Any] = {}
    for word, value in values.items():
        if word not in readers:
            raise UsageError(
                f"{text!r}: unknown option {word!r} of an {'input' if is_input else 'output'}; "
                f"{suggestion(word, readers)}"
            )
        try:
            read[word] = readers[word](value)
        except ValueError as err:
            raise UsageError(f"{text!r}: {word} is {value!r}; expected {err}") from err
    if "order" in read and "low_pass" not in read:
        raise UsageError(
            f"{text!r}: order says nothing by itself; expected low_pass beside it, a frequency in Hz"
        )
    return SignalSource(topic, field, **read)


def _number(least: float, what: str, is_open: bool = False) -> Callable[[object], float]:
    def read(value: object) -> float:
        try:
            number = float(str(value))
        except ValueError:
            raise ValueError(what) from None
        if not math.isfinite(number) or number < least or (is_open and number == least):
            raise ValueError(what)
        return number

    return read


def _scale(value: object) -> float:
    number = _number(-math.inf, what := "a number that is not 0: SI units in one of the field's")(value)
    if number == 0.0:
        raise ValueError(what)
    return number


def _word(*known: str) -> Callable[[object], str]:
    def read(value: object) -> str:
        if str(value) not in known:
            raise ValueError(f"one of {', '.join(known)}")
        return str(value)

    return read


def _known_unit(value: object) -> str:
    if find_unit(str(value)) is None:
        raise ValueError(f"one of {known_units()}")
    return str(value).strip()


def _name(value: object) -> str:
    if not str(value).strip():
        raise ValueError("a name")
    return str(value).strip()


_COMMON: dict[str, Callable[[object], Any]] = {
    "name": _name,
    "unit": _known_unit,
    "delay": _number(-math.inf, "seconds by which its stamps are late"),
    "sd": _number(0.0, "a standard deviation > 0 in SI units", is_open=True),
    "scale": _scale,
}
_INPUT_OPTIONS = _COMMON | {"kind": _word(*INPUT_KINDS), "hold": _word(*HOLDS)}
_OUTPUT_OPTIONS = _COMMON | {
    "kind": _word(*SENSORS),
    "exposure": _number(0.0, "seconds >= 0"),
    "low_pass": _number(0.0, "a frequency > 0 in Hz", is_open=True),
    "order": lambda value: int(_word("1", "2")(value)),
}
