"""Progress of a verb: a bar where somebody watches a terminal, a line now and then where output is kept."""

from __future__ import annotations

import sys
import time
from typing import Any, TextIO

_LINE_EVERY_S = 5.0


class _PresentStandardError:
    """The standard error as it is when something is written to it: a film's decoder lends it another descriptor."""

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)


class Progress:
    """Progress through one stage of known length.

    Parameters
    ----------
    title : str -- what is being done
    total : float -- length of the stage in its unit
    unit : str -- "s", "samples", ...
    stream : file -- where to write; stderr, so that results on stdout stay clean
    """

    def __init__(self, title: str, total: float, unit: str = "", stream: TextIO | None = None) -> None:
        self.title, self.total, self.unit = title, total, unit
        self._stream: Any = stream or _PresentStandardError()
        self._bar = self._terminal_bar() if self._stream.isatty() else None
        self._last_line = time.monotonic()

    def _terminal_bar(self) -> Any:
        from tqdm import tqdm

        return tqdm(
            total=self.total,
            desc=f"{self.title:<24}",
            file=self._stream,
            leave=False,
            bar_format="{desc} {bar:30} {percentage:3.0f} %  {postfix}",
        )

    def update(self, done: float, note: str = "") -> None:
        """Say how far the stage has come.

        Parameters
        ----------
        done : float -- in the stage's unit, from 0 to ``total``
        note : str -- a few words beside the bar
        """
        done = min(done, self.total)
        if self._bar is not None:
            self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(done - self._bar.n)
        elif time.monotonic() - self._last_line >= _LINE_EVERY_S:
            self._last_line = time.monotonic()
            print(
                f"  {self.title}: {done:.0f} of {self.total:.0f} {self.unit}  {note}".rstrip(),
                file=self._stream,
            )

    def finish(self, result: str) -> None:
        """Close the stage with its result in one line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
        print(f"{self.title:<24} {result}", file=self._stream, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
