"""What is known while the rig still runs: ``identification/live``.

One JSON text carries the estimate from the samples that have arrived. It is made by ``live_identifier`` and
read by whatever shows it; both hold the record below, which is checked where it enters.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from beam_ident.data.stored_form import rebuilt
from beam_ident.errors import ModelFormatError
from beam_ros.messages.errors import MessageContentError
from beam_ros.process.strict_json import strict_json

State = Literal["waiting", "growing", "known", "ended", "failed"]


@dataclass(frozen=True)
class LiveMode:
    """A mode as it is known now: natural frequency [Hz] and damping ratio with their standard deviations."""

    frequency_hz: float
    frequency_sd_hz: float | None
    damping_ratio: float
    damping_ratio_sd: float | None


@dataclass(frozen=True)
class LiveOutput:
    """Magnitudes of one output's frequency response: the model's, its standard deviations, and the measured ones.

    Each has one number for every frequency of the response; ``None`` where nothing can be said.
    """

    model: tuple[float | None, ...]
    model_sd: tuple[float | None, ...]
    measured: tuple[float | None, ...]


@dataclass(frozen=True)
class LiveResponse:
    """Frequency responses of all outputs to one input, at the same frequencies [Hz]."""

    input: str
    frequency_hz: tuple[float, ...]
    outputs: Mapping[str, LiveOutput]


@dataclass(frozen=True)
class LiveShape:
    """Mode shapes at the markers: heights above the clamp [m], and one row of values for each mode."""

    heights_m: tuple[float, ...]
    modes: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class LiveTest:
    """An assumption, the test that asked for it, its p-value (``None`` where not tested) and what came of it."""

    assumption: str
    test: str
    p: float | None
    verdict: Literal["holds", "fails", "not tested"]


@dataclass(frozen=True)
class LiveAim:
    """A quantity that shall be known: relative standard deviation asked and reached, and the time to go [s]."""

    name: str
    relative_sd_asked: float
    relative_sd: float | None
    seconds_to_go: float | None
    met: bool


@dataclass(frozen=True)
class LiveCost:
    """What the estimate costs: share of one core since the start, and the duration of the last fit [s]."""

    share_of_core: float
    seconds_of_last_fit: float


@dataclass(frozen=True)
class LiveIdentification:
    """The estimate so far.

    Attributes
    ----------
    state : str -- waiting for data, growing, known (every aim is met), ended (the final answer), or failed
    sentence : str -- what goes on now, or the cause of a failure and its remedy
    record_s : float -- duration of the record that was used [s]
    samples : mapping of str to int -- samples that were used, of ``input`` and of each output
    started : float or None -- header time of the record's first sample [s, UNIX]
    modes : tuple of LiveMode -- by natural frequency, lowest first
    response : LiveResponse or None
    shape : LiveShape or None
    tests : tuple of LiveTest
    aims : tuple of LiveAim
    cost : LiveCost
    version : int -- of the JSON's form; another form is refused, not guessed
    """

    state: State
    sentence: str
    record_s: float
    samples: Mapping[str, int]
    started: float | None
    modes: tuple[LiveMode, ...]
    response: LiveResponse | None
    shape: LiveShape | None
    tests: tuple[LiveTest, ...]
    aims: tuple[LiveAim, ...]
    cost: LiveCost
    version: Literal[1] = 1

    def to_json(self) -> str:
        """Return the JSON text; what is not finite becomes null."""
        return strict_json(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> LiveIdentification:
        """Read the JSON text.

        Raises
        ------
        MessageContentError
            No JSON object, another version, or an entry that is missing, of another kind or of another length.
        """
        try:
            content: Any = json.loads(text)
        except (ValueError, RecursionError) as err:
            raise MessageContentError(f"live identification {text[:80]!r} is no JSON ({err})") from err
        found = content.get("version") if isinstance(content, Mapping) else type(content).__name__
        if found != cls.version:
            raise MessageContentError(
                f"live identification of version {found!r}; expected {cls.version}: let both ends be of one release"
            )
        try:
            read = rebuilt(cls, content, "live identification")
        except ModelFormatError as err:
            raise MessageContentError(str(err)) from err
        _require_lengths(read)
        return read


def _require_lengths(read: LiveIdentification) -> None:
    """Refuse curves and shapes that do not go with their own axis."""
    if read.response is not None:
        for name, output in read.response.outputs.items():
            for curve in (output.model, output.model_sd, output.measured):
                _require_equal(f"response of {name}", len(curve), len(read.response.frequency_hz))
    if read.shape is not None:
        for k, row in enumerate(read.shape.modes):
            _require_equal(f"shape of mode {k + 1}", len(row), len(read.shape.heights_m))


def _require_equal(what: str, found: int, expected: int) -> None:
    if found != expected:
        raise MessageContentError(f"live identification: {what} has {found} values; expected {expected}")
