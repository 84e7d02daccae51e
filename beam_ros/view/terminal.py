"""What the page shows, in a few lines of a terminal that change in place; plain lines where output is kept."""

from __future__ import annotations

import math
import shutil
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any, TextIO

from beam_ros.view.rig_log import marked
from beam_ros.view.scene import Scene


def _number(value: float | None, unit: str, decimals: int = 2) -> str:
    return "not known" if value is None else f"{value:.{decimals}f} {unit}"


def _with_sd(value: float, sd: float | None) -> str:
    """Write a value with as many decimals as its standard deviation has two digits."""
    if sd is None or not sd > 0.0:
        return f"{value:.5g}"
    decimals = max(0, 1 - math.floor(math.log10(sd)))
    return f"{value:.{decimals}f} ± {sd:.{decimals}f}"


def status_lines(scene: Scene) -> list[str]:
    """Return how the rig is now: axis, motion against its limits, recording, losses, and the estimate so far."""
    axis, shape, beam = scene.part("axis"), scene.part("shape"), scene.part("beam")
    silent = " (nothing is heard of the hub)" if axis["silent"] else ""
    lines = [
        f"axis      {axis['words']}{silent}",
        f"hub       {_number(shape['hub'], 'mm')} of ± {beam['hub_limit']:.0f} mm; "
        f"tip against it {_number(shape['tip'], 'mm')} of ± {beam['tip_limit']:.0f} mm",
    ]
    if sequence := scene.part("sequence"):
        lines.append(f"sequence  {sequence['words']}")
    if (recorder := scene.part("recorder")) and recorder["recording"]:
        lines.append(
            f"recorder  {recorder['messages']} messages, {recorder['lost']} lost, to {recorder['path']}"
        )
    lost = [f"{loss['count']} {loss['what']}" for loss in scene.part("losses") if loss["count"]]
    if lost:
        lines.append(f"lost      {', '.join(lost)}")
    return [*lines, *_estimate(scene.part("identification"))]


def _estimate(live: Mapping[str, Any] | None) -> list[str]:
    if live is None:
        return []
    lines = [f"estimate  {live['sentence']}"]
    for k, mode in enumerate(live["modes"], start=1):
        frequency = _with_sd(mode["frequency_hz"], mode["frequency_sd_hz"])
        sd = mode["damping_ratio_sd"]
        damping = _with_sd(100.0 * mode["damping_ratio"], None if sd is None else 100.0 * sd)
        lines.append(f"  mode {k}  {frequency} Hz, damping {damping} %")
    for aim in live["aims"]:
        left = aim["seconds_to_go"]
        to_go = "reached" if aim["met"] else "not known when" if left is None else f"{left:.0f} s to go"
        lines.append(f"  {aim['name']}: {to_go}")
    return lines


def log_line(entry: Mapping[str, Any]) -> str:
    """Return an entry of the log as a line."""
    at = time.strftime("%H:%M:%S", time.localtime(entry["at"]))
    return f"{at}  {marked(entry)}"


class ChangingLines:
    """Lines that stay, and below them lines that change where somebody watches a terminal.

    Parameters
    ----------
    stream : file -- where they go
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lock = threading.Lock()
        self._shown: list[str] = []
        self.is_watched = stream.isatty()

    def say(self, line: str) -> None:
        """Print a line that stays."""
        with self._lock:
            self._stream.write(f"{self._erasure()}{line}\n")
            self._write(self._shown)

    def show(self, lines: Sequence[str]) -> None:
        """Put lines in the place of those that were shown last; nothing where output is kept."""
        if not self.is_watched:
            return
        width = shutil.get_terminal_size().columns
        cut = [line if len(line) < width else f"{line[: width - 2]}…" for line in lines]
        with self._lock:
            if cut != self._shown:
                self._stream.write(self._erasure())
                self._write(cut)

    def _erasure(self) -> str:
        """Return what moves up to the first changing line and clears all below (ECMA-48: CPL and ED)."""
        return f"\x1b[{len(self._shown)}F\x1b[J" if self._shown else ""

    def _write(self, lines: Sequence[str]) -> None:
        self._shown = list(lines)
        self._stream.write("".join(f"{line}\n" for line in lines))
        self._stream.flush()
