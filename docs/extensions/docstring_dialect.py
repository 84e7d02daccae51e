"""Read the project's dialect of numpydoc, which may put a name, its type and its meaning on one line.

``y : ndarray, shape (n_samples,) -- displacement [m]`` becomes the two lines that Sphinx's napoleon expects, and
the bars of a magnitude stay bars: reStructuredText would take them for a substitution.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns", "Other Parameters")
_UNDERLINE = re.compile(r"\s*-{3,}\s*$")
_LITERAL_OR_BAR = re.compile(r"``.*?``|\|")


def spread_over_two_lines(lines: list[str]) -> list[str]:
    """Return a docstring's lines with every entry's meaning on a line of its own.

    Parameters
    ----------
    lines : list of str -- the docstring, indentation removed

    Returns
    -------
    list of str
    """
    spread: list[str] = []
    in_entries = False
    for place, line in enumerate(lines):
        is_heading = (
            place + 1 < len(lines) and bool(_UNDERLINE.match(lines[place + 1])) and bool(line.strip())
        )
        if is_heading:
            in_entries = line.strip() in _SECTIONS
        entry, separator, meaning = line.partition(" -- ")
        if in_entries and separator and not line.startswith(" "):
            spread += [entry.rstrip(), "    " + meaning]
        else:
            spread.append(line)
    return spread


def keep_bars(line: str) -> str:
    """Return a line whose bars outside of literals are escaped."""
    return _LITERAL_OR_BAR.sub(lambda found: r"\|" if found.group() == "|" else found.group(), line)


def _process(_app: Sphinx, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = [keep_bars(line) for line in spread_over_two_lines(lines)]


def setup(app: Sphinx) -> dict[str, Any]:
    """Come before napoleon, whose priority is 500."""
    app.connect("autodoc-process-docstring", _process, priority=400)
    return {"parallel_read_safe": True}
