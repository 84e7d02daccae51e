"""All that the page shows, made of the rig's messages as they come from the wire or from a bag.

A reader of the page keeps a cursor: which version of each part it has, how far its traces and its log go. The scene
tells it what it lacks, so that a slow reader receives the newest state and never a queue. Several threads may ask
and tell: one lock guards the whole.
"""

from __future__ import annotations

import dataclasses
import json
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from beam_ros.bags.batches import decode_batch
from beam_ros.bags.errors import BagError
from beam_ros.bags.signals import message_decoder
from beam_ros.errors import ParameterFileError
from beam_ros.interfaces import graph
from beam_ros.interfaces.parameter_files import in_present_words
from beam_ros.messages import (
    BagTypes,
    Health,
    LiveIdentification,
    MessageContentError,
    read_diagnostics,
    read_displacement,
    read_json,
)
from beam_ros.process.strict_json import strict_json
from beam_ros.rig.rig import Rig
from beam_ros.view.drawn_beam import DrawnBeam
from beam_ros.view.losses import Loss, losses_of_nodes
from beam_ros.view.pictures import Pictures
from beam_ros.view.rig_log import Level, RigLog, words_of_mode, words_of_sequence
from beam_ros.view.traces import Trace
from beam_ros.vision.errors import ImageFormatError

_T = TypeVar("_T")

SHOWN_TOPICS = (
    "hub/measured",
    "hub/mode",
    "hub/sequence_state",
    "beam/displacement",
    "beam/markers",
    "camera/image_raw",
    "camera/image_raw/compressed",
    "excitation/info",
    "recorder/state",
    "identification/live",
    "identification/result",
    "/diagnostics",
)
"""What the page is made of; it subscribes to nothing else."""


_NOTHING_YET: Mapping[str, Any] = {
    "axis": {"words": "nothing was heard of it", "mode": None, "silent": False},
    "sequence": None,
    "recorder": None,
    "nodes": [],
}


@dataclass
class Cursor:
    """How far a reader is: versions by part, epoch and rows of traces and log, which picture."""

    parts: dict[str, int] = field(default_factory=dict)
    rows: dict[str, tuple[int, int]] = field(default_factory=dict)
    picture: tuple[int, bool] = (0, False)


class Scene:
    """The state of the page.

    Parameters
    ----------
    rig : Rig -- whose beam is drawn, until ``excitation/info`` describes the one that runs
    source : str -- "rig" for a running one, or "bag"
    title : str -- what is shown, for the head of the page
    is_rig_given : bool -- the person named the rig's file: what ``excitation/info`` says of it is not taken
    silence_s : float -- so long without a sample of the hub is worth a word [s]
    """

    def __init__(
        self, rig: Rig, *, source: str, title: str, is_rig_given: bool = False, silence_s: float = 2.0
    ) -> None:
        self._lock = threading.RLock()
        self._types = BagTypes()
        self._source, self._title, self._silence_s = source, title, silence_s
        self._rig, self._is_rig_given = rig, is_rig_given
        self._parts: dict[str, tuple[int, str]] = {}
        self._health: dict[str, tuple[float, Health]] = {}
        self._beam = DrawnBeam(rig)
        self._is_drawn = False
        self._hub_heard_s: float | None = None
        self._is_hub_silent = False
        self._live_state = ""
        self.pictures = Pictures()
        self.log = RigLog()
        self._takers: dict[str, Callable[[bytes, float, float], None]] = {
            "hub/measured": self._take_hub,
            "beam/displacement": self._take_displacement,
            "beam/markers": self._take_markers,
            "camera/image_raw": self._take_image,
            "camera/image_raw/compressed": self._take_compressed,
            "hub/mode": self._take_mode,
            "hub/sequence_state": self._take_sequence,
            "recorder/state": self._take_recorder,
            "excitation/info": self._take_excitation,
            "identification/live": self._take_live,
            "identification/result": self._take_result,
            "/diagnostics": self._take_diagnostics,
        }
        self._show_rig(rig, "the rig file that was given" if is_rig_given else "the packaged rig file")
        for part, content in (*_NOTHING_YET.items(), ("identification", None), ("losses", [])):
            self._set(part, content)

    # --- what comes in

    def take(self, topic: str, data: bytes, now_s: float, day_s: float) -> None:
        """Take a message; one that cannot be read is said in the log.

        Parameters
        ----------
        topic : str -- one of ``SHOWN_TOPICS``
        data : bytes -- CDR
        now_s : float -- steady time [s]; that of the bag where a bag is played
        day_s : float -- time of day, for the log [s, UNIX]
        """
        with self._lock:
            try:
                self._takers[topic](data, now_s, day_s)
            except (MessageContentError, BagError, ImageFormatError) as err:
                self.log.change(f"unreadable {topic}", day_s, "warning", f"{topic} cannot be read: {err}")

    def note(self, level: Level, text: str, day_s: float) -> None:
        """Add an entry to the log."""
        with self._lock:
            self.log.add(day_s, level, text)

    def show(self, part: str, content: Any) -> None:
        """Set a part of the page that no message brings, as the player's position."""
        with self._lock:
            self._set(part, content)

    def show_losses(self, losses: Iterable[Loss]) -> None:
        """Set the table of losses."""
        self.show("losses", [dataclasses.asdict(loss) for loss in losses])

    def show_live(self, live: LiveIdentification, day_s: float) -> None:
        """Set the estimate so far."""
        with self._lock:
            self._set("identification", dataclasses.asdict(live))
            if live.state != self._live_state:
                self._live_state = live.state
                level: Level = "error" if live.state == "failed" else "info"
                self.log.add(day_s, level, f"identification: {live.sentence}")

    def begin_anew(self) -> None:
        """Forget the motion, what is under way and the log: a bag is entered at another place."""
        with self._lock:
            for part, content in _NOTHING_YET.items():
                self._set(part, content)
            self._health.clear()
            self.log.clear()
            self._live_state = ""
            self._beam.begin_anew()
            self.pictures.forget()
            self._hub_heard_s = None
            self._is_drawn = False

    def _set(self, part: str, content: Any) -> None:
        text = strict_json(content)
        version, before = self._parts.get(part, (0, ""))
        if text != before:
            self._parts[part] = (version + 1, text)

    def _show_rig(self, rig: Rig, whence: str) -> None:
        limit_mm = 500.0 * rig.hub.travel
        self._set(
            "beam",
            {
                "source": self._source,
                "title": self._title,
                "rig": whence,
                "length": 1e3 * rig.beam.length,
                "hub_limit": limit_mm,
                "tip_limit": 1e3 * rig.hub.max_tip_deflection,
                "names": list(rig.markers.names),
                "marker_heights": [1e3 * height for height in rig.markers.heights],
                "theory": self._beam.theory(),
            },
        )

    def _read(self, data: bytes, topic: str, read: Callable[[Any], _T]) -> _T:
        return message_decoder(self._types, graph.TOPICS[topic].type_name, read)(data)

    def _take_hub(self, data: bytes, now_s: float, day_s: float) -> None:
        self._beam.add_hub(decode_batch(data))
        self._hub_heard_s, self._is_drawn = now_s, False
        if self._beam.stepped_back_s:
            text = f"the stamps stepped back by {self._beam.stepped_back_s:.3f} s: the curves begin anew"
            self.log.add(day_s, "warning", text)
            self._beam.stepped_back_s = 0.0

    def _take_displacement(self, data: bytes, _now_s: float, _day_s: float) -> None:
        self._beam.add_markers(self._read(data, "beam/displacement", read_displacement))
        self._is_drawn = False

    def _take_markers(self, data: bytes, _now_s: float, _day_s: float) -> None:
        self.pictures.take_markers(data)

    def _take_image(self, data: bytes, now_s: float, _day_s: float) -> None:
        self.pictures.take_frame(data, now_s, is_compressed=False)

    def _take_compressed(self, data: bytes, now_s: float, _day_s: float) -> None:
        self.pictures.take_frame(data, now_s, is_compressed=True)

    def _take_mode(self, data: bytes, _now_s: float, day_s: float) -> None:
        mode = self._read(data, "hub/mode", read_json)
        self._set("axis", {"words": words_of_mode(mode), "mode": mode, "silent": self._is_hub_silent})
        self.log.mode(day_s, mode)

    def _take_sequence(self, data: bytes, _now_s: float, day_s: float) -> None:
        sequence = self._read(data, "hub/sequence_state", read_json)
        self._set("sequence", {**sequence, "words": words_of_sequence(sequence)})
        self.log.sequence(day_s, sequence)

    def _take_recorder(self, data: bytes, _now_s: float, day_s: float) -> None:
        recorder = self._read(data, "recorder/state", read_json)
        shown = {name: recorder.get(name) for name in ("recording", "path", "messages", "lost", "failure")}
        self._set("recorder", shown)
        self.log.recorder(day_s, recorder)

    def _take_excitation(self, data: bytes, _now_s: float, day_s: float) -> None:
        info = self._read(data, "excitation/info", read_json)
        recipe = info.get("recipe")
        if isinstance(recipe, Mapping):
            self.log.change("excitation", day_s, "info", f"excitation: {recipe.get('kind')}")
        if self._is_rig_given or not isinstance(info.get("rig"), Mapping):
            return
        try:
            rig = Rig.from_nested(in_present_words(info["rig"]))
        except (ParameterFileError, AttributeError) as err:
            text = f"excitation/info describes a rig that this version does not read: {err}"
            self.log.change("rig", day_s, "warning", text)
            return
        if rig != self._rig:
            self._rig, self._beam = rig, DrawnBeam(rig, first_epoch=self._beam.hub.epoch + 1)
        self._show_rig(rig, "what excitation/info says of the rig")

    def _take_live(self, data: bytes, _now_s: float, day_s: float) -> None:
        text = self._read(data, "identification/live", lambda message: str(message.data))
        self.show_live(LiveIdentification.from_json(text), day_s)

    def _take_result(self, data: bytes, _now_s: float, day_s: float) -> None:
        result = self._read(data, "identification/result", read_json)
        report = result.get("report")
        where = f": the report is {report}" if report else ""
        self.log.change("result", day_s, "info", f"a model was identified{where}")

    def _take_diagnostics(self, data: bytes, now_s: float, day_s: float) -> None:
        for status in self._read(data, "/diagnostics", read_diagnostics):
            self._health[status.hardware_id or status.name] = (now_s, status)
            self.log.health(day_s, status.hardware_id or status.name, status.level, status.message)
        if self._source == "rig":
            losses = losses_of_nodes(status for _, status in self._health.values())
            self._set("losses", [dataclasses.asdict(loss) for loss in losses])

    # --- what goes out

    def look(self, now_s: float, day_s: float) -> None:
        """Notice what has fallen silent.

        Parameters
        ----------
        now_s, day_s : float -- as of ``take``
        """
        with self._lock:
            heard_s = self._hub_heard_s
            is_silent = heard_s is None or now_s - heard_s > self._silence_s
            if is_silent != self._is_hub_silent and heard_s is not None:
                text = "nothing is heard of the hub any more" if is_silent else "the hub is heard again"
                self.log.add(day_s, "warning" if is_silent else "info", text)
            if is_silent != self._is_hub_silent:
                self._is_hub_silent = is_silent
                axis = {**self.part("axis"), "silent": is_silent}
                self._set("axis", axis)
            nodes = []
            for name, (at_s, status) in sorted(self._health.items()):
                is_gone = now_s - at_s > 2.0 * self._silence_s
                level, words = (
                    ("STALE", "is not heard any more") if is_gone else (status.level, status.message)
                )
                self.log.health(day_s, name, level, words)
                nodes.append({"name": name, "level": level, "sentence": words})
            self._set("nodes", nodes)

    def part(self, name: str) -> Any:
        """Return a part of the page as plain values."""
        with self._lock:
            self._draw()
            return json.loads(self._parts[name][1])

    def new_entries(self, cursor: Cursor) -> list[dict[str, Any]]:
        """Return the entries of the log that a reader lacks, and set its cursor to have them."""
        with self._lock:
            entries: list[dict[str, Any]] = self.log.since(*cursor.rows.get("log", (-1, 0)))["rows"]
            cursor.rows["log"] = (self.log.epoch, self.log.total)
            return entries

    def news(self, cursor: Cursor) -> str:
        """Return what a reader lacks, as a JSON object, and set its cursor to have it."""
        with self._lock:
            self._draw()
            texts = [
                f"{strict_json(name)}:{text}"
                for name, (version, text) in self._parts.items()
                if cursor.parts.get(name) != version
            ]
            cursor.parts = {name: version for name, (version, _) in self._parts.items()}
            growing: dict[str, Trace | RigLog] = {
                "hub": self._beam.hub,
                "tip": self._beam.tip,
                "log": self.log,
            }
            for name, kept in growing.items():
                rows = kept.since(*cursor.rows.get(name, (-1, 0)))
                cursor.rows[name] = (kept.epoch, kept.total)
                if rows["rows"] or rows["anew"]:
                    texts.append(f'"{name}":{strict_json(rows)}')
            return "{" + ",".join(texts) + "}" if texts else ""

    def picture(self, cursor: Cursor) -> bytes:
        """Return the camera's newest frame where a reader does not have it, else nothing."""
        with self._lock:
            shown = self.pictures.shown()
            if cursor.picture == shown:
                return b""
            cursor.picture = shown
            return self.pictures.packed()

    def _draw(self) -> None:
        if not self._is_drawn:
            self._is_drawn = True
            self._set("shape", {**self._beam.shape(), "speed": 1e3 * self._beam.speed})
