"""One self-contained HTML page: what every report of the suite is written with, so that there is one style.

A page is a list of sections, and a section a list of blocks: paragraphs, tables, figures, equations, warnings.
The text is semantic HTML, figures stay text inside the page (SVG with fonts of the reader), nothing is loaded from
anywhere.  It reads in light and in dark, on a telephone and on A4 paper: what is wider than the screen scrolls in
a box of its own, and on paper it shrinks.
"""

from __future__ import annotations

import colorsys
import html
import io
import os
import re
from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from beam_ident.errors import ReportError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tone = Literal["", "good", "doubt", "bad"]
Drawn = Literal["none", "sheet", "all"]
"""Which figures a page has: none, those of the sheet to sign, or those of the evidence too."""

_BEFORE_SIGNING = (
    "Every reservation above is understood: one that cannot be explained is a finding, not a nuisance.",
    "The intervals hold what is known besides: heights and scale are in the shapes, not in the frequencies; the "
    "amplitude is in neither.",
    "The bags are kept, and their checksums, under Provenance, are written down.",
    "A colleague could repeat it: the bag carries the rig and the recipe of the signal, Provenance the versions.",
)
_WIDE = 8  # columns from which a table is set smaller on paper
_NARROW = 6.0  # a figure below this width [inch] is not made as wide as the page
_NUMBER = re.compile(
    r"[(]?[<>≈]?\s?[+\-−]?\d[\d.,]*(e[+-]?\d+)?( (±|to) [+\-−]?[\d.]+)?[)]?(e[+-]?\d+)?(\s?\S{1,6})?"
)
_PARENTHESES, _UPRIGHT = re.compile(r"<mo>([()])</mo>"), r'<mo stretchy="false">\1</mo>'
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}\b")
_INK, _PAPER_OF_DARK = "#e5e7eb", "#111827"


class Cell(NamedTuple):
    """A cell of a table that says more than its text: how good that is, and where it leads.

    Attributes
    ----------
    text : str
    tone : "good", "doubt", "bad" or empty
    link : str -- address to link to, relative to the page; empty for none
    """

    text: str
    tone: Tone = ""
    link: str = ""


class Page:
    """A page that is written block after block.

    Parameters
    ----------
    title : str
    lead : str -- what a reader must know who reads one sentence only
    simulated : str -- what stands under the title and in the head of every sheet where no beam was measured
    drawn : "none", "sheet" or "all" -- which figures it has

    Attributes
    ----------
    figures : dict from name to SVG -- every figure that was given a name, as a file of its own would hold it
    """

    def __init__(self, title: str, lead: str, simulated: str = "", drawn: Drawn = "all") -> None:
        self.title, self.lead, self.simulated, self.drawn = title, lead, simulated, drawn
        self.figures: dict[str, str] = {}
        self._head: list[dict[str, Any]] = []
        self._sections: list[dict[str, Any]] = []
        self._is_evidence = False
        self._colours: set[str] = set()
        self._n_boxes = 0
        self._n_figures = 0

    def section(self, heading: str) -> None:
        """Begin a section; what follows belongs to it."""
        begins = self._is_evidence and not any(own["is_evidence"] for own in self._sections)
        own = {"heading": heading, "blocks": [], "is_evidence": self._is_evidence, "begins_evidence": begins}
        self._sections.append(own)

    def evidence(self) -> None:
        """Fold the sections that follow on screen, and number them on paper: they stand behind the sheet to sign."""
        self._is_evidence = True

    @property
    def draws(self) -> bool:
        """Whether a figure that is added here is shown: what only a figure needs need not be computed otherwise."""
        return self.drawn == "all" or (self.drawn == "sheet" and not self._is_evidence)

    def subsection(self, heading: str) -> None:
        """Begin a part of the section."""
        self._add("subsection", text=heading)

    def paragraph(self, text: str) -> None:
        """Add a paragraph of plain text."""
        self._add("paragraph", text=text)

    def link(self, text: str, address: str) -> None:
        """Add a paragraph that is a link, to a file beside the page or into the net."""
        self._add("link", text=text, address=address)

    def warning(self, text: str, remedy: str = "", tone: Tone = "bad") -> None:
        """Add what a reader must not overlook, with what to do about it; a verdict, in a good tone."""
        self._add("warning", text=text, remedy=remedy, tone=tone)

    def equation(self, mathml: str, text: str) -> None:
        """Add an equation as MathML, the content of ``<math>``, with the words that a screen reader speaks."""
        self._add("equation", mathml=_PARENTHESES.sub(_UPRIGHT, mathml), text=text)

    def signature(self, operator: str = "") -> None:
        """Add what must be understood before signing, and who answers for the page, with date and signature."""
        self.section("Before you sign")
        self._add("checklist", texts=_BEFORE_SIGNING)
        if not operator:
            self.warning(
                "Nobody is named as operator.",
                "Write down who answers for the data: by hand below, or with --operator where the report is made.",
                tone="doubt",
            )
        rows = [("measured by", operator), ("checked by", ""), ("approved by", "")]
        self.table(
            ["role", "name", "date", "signature"],
            [[*row, "", ""] for row in rows],
            "Signatures.",
            kind="signatures",
        )

    def table(
        self,
        columns: Sequence[str],
        rows: Sequence[Sequence[str | Cell]],
        caption: str,
        chosen: Container[int] = (),
        kind: str = "",
    ) -> None:
        """Add a table; the first cell of a row is its heading.

        Parameters
        ----------
        columns : sequence of str -- their headings, with the unit
        rows : sequence of sequence of str or Cell -- as long as ``columns``
        caption : str -- a sentence that says what the table means
        chosen : container of int -- indices of the rows that stand out
        kind : str -- "signatures" for lines that are written on, "listing" for names with values

        Raises
        ------
        ReportError
            A column without a heading, or a row with another number of cells than there are columns.
        """
        if not all(columns):
            raise ReportError(
                f"the table {caption!r} has the columns {', '.join(map(repr, columns))}; expected a heading for "
                "each: a screen reader says it with every cell"
            )
        for number, row in enumerate(rows):
            if len(row) != len(columns):
                raise ReportError(
                    f"row {number} of the table {caption!r} has {len(row)} cells; expected {len(columns)}, one for "
                    "each column: give a dash where there is nothing to say"
                )
        cells = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in rows]
        is_number = [
            all(_NUMBER.fullmatch(row[k].text) or row[k].text in ("", "–") for row in cells)
            and any(row[k].text for row in cells)
            for k in range(len(columns))
        ]
        self._add(
            "table",
            columns=columns,
            kinds=["number" if number else "text" for number in is_number],
            rows=[[cell._replace(text=_unbroken(cell.text)) for cell in row] for row in cells],
            caption=caption,
            chosen=chosen,
            kind=kind or ("wide" if len(columns) >= _WIDE else ""),
            label=f"t{self._count_box()}",
        )

    def figure(
        self, figure: Figure | Callable[[], Figure], caption: str, alt: str, name: str = "", number: str = ""
    ) -> None:
        """Add a figure of Matplotlib as SVG, where figures are wanted.

        Parameters
        ----------
        figure : matplotlib.figure.Figure, or what draws it -- called where it is shown
        caption : str -- what it means, and where not to trust it
        alt : str -- what it shows, for those who do not see it
        name : str -- its stem where it is also kept in ``figures``
        number : str -- in place of the page's own count, where a page takes over the numbers of another work
        """
        if not self.draws:
            return
        figure = figure() if callable(figure) else figure
        svg = _svg(figure, alt)
        if name:
            self.figures[name] = svg
        width = float(figure.get_size_inches()[0])
        self.drawing(svg, caption, number, width if width < _NARROW else None)

    def drawing(self, svg: str, caption: str, number: str = "", width_in: float | None = None) -> None:
        """Add a figure that is drawn already, as ``figures`` holds it.

        Parameters
        ----------
        svg : str
        caption : str -- what it means, and where not to trust it
        number : str -- in place of the page's own count
        width_in : float, optional -- of a figure that is narrower than the page [inch]
        """
        self._n_figures += 1
        own, kind = _with_own_names(svg, self._n_figures), " white"
        if "<image" not in svg:  # pictures keep their colours, and white around them
            self._colours |= {colour.lower() for colour in _COLOUR.findall(own)}
            own, kind = _COLOUR.sub(lambda match: f"var(--c{match[0][1:].lower()})", own), ""
        if width_in is not None:
            own = own.replace("<svg", f'<svg style="min-width:0;max-width:{width_in:.2f}in"', 1)
        words = f"Figure {number or self._n_figures}. {caption}"
        self._add("figure", svg=own, words=words, kind=kind, label=f"t{self._count_box()}")

    def text(self) -> str:
        """Return the whole page as HTML."""
        from jinja2 import Environment, PackageLoader, StrictUndefined  # here: few who load this write a page

        environment = Environment(
            loader=PackageLoader("beam_ident.report", "."), autoescape=True, undefined=StrictUndefined
        )
        return environment.get_template("page.html").render(
            page=self,
            head=self._head,
            sections=self._sections,
            style=Path(__file__).with_name("page.css").read_text(encoding="utf-8"),
            palette=self._palette(),
            running={
                "title": _in_style(self.title),
                "simulated": "SIMULATED DATA" if self.simulated else "",
            },
        )

    def write(self, path: str | Path, overwrite: bool = False) -> Path:
        """Write the page as one file, which appears whole or not at all.

        Parameters
        ----------
        path : path of the file; its folder is made where it is missing
        overwrite : bool -- whether a file that is there may be replaced

        Raises
        ------
        ReportError
            The file is there and may not be replaced.
        """
        target = Path(path)
        if target.exists() and not overwrite:
            raise ReportError(
                f"{target}: is there already, and would be lost; expected a path that is free: give another, "
                "or allow it to be overwritten"
            )
        write_whole(target, self.text())
        return target

    def provenance(self, groups: Mapping[str, Mapping[str, Any]]) -> None:
        """Begin the section that says where the numbers come from, a table for each group; nothing without groups."""
        if groups:
            self.section("Provenance")
        for group, entries in groups.items():
            rows = [[key, str(value)] for key, value in entries.items()]
            self.table([group, "value"], rows, f"{group}.", kind="listing")

    def _add(self, what: str, **parts: Any) -> None:
        (self._sections[-1]["blocks"] if self._sections else self._head).append({"is": what, **parts})

    def _count_box(self) -> int:
        self._n_boxes += 1
        return self._n_boxes

    def _palette(self) -> str:
        """Name every colour of the figures, as it is on white and as it is on a dark page."""
        if not self._colours:
            return ""
        light = ";".join(f"--c{colour[1:]}:{colour}" for colour in sorted(self._colours))
        dark = ";".join(f"--c{colour[1:]}:{dark_of(colour)}" for colour in sorted(self._colours))
        return (
            f":root{{{light}}}\n@media (prefers-color-scheme:dark){{:root{{{dark}}}}}\n"
            f"@media print{{:root{{{light}}}}}\n"
        )


def write_whole(target: Path, text: str) -> None:
    """Write a text file, which appears whole or not at all, even where the power fails.

    Its folder is made where it is missing.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.partial")
    try:
        with partial.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def dark_of(colour: str) -> str:
    """Return the colour that stands on a dark page for one that stands on white.

    White becomes the page, black the ink, and what lies between is turned over.  What can be read on white at 4.5
    to 1, or seen at 3 to 1, becomes light enough for the same on the dark page (WCAG 2.1, 1.4.3 and 1.4.11).
    """
    if colour.lower() == "#000000":
        return _INK
    if colour.lower() == "#ffffff":
        return _PAPER_OF_DARK
    red, green, blue = (int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    hue, lightness, saturation = colorsys.rgb_to_hls(red, green, blue)
    lightness = 0.93 - 0.82 * lightness
    wanted = min(_contrast(colour, "#ffffff"), 4.5)
    while True:
        turned = "#" + "".join(
            f"{round(255 * part):02x}" for part in colorsys.hls_to_rgb(hue, lightness, saturation)
        )
        if _contrast(turned, _PAPER_OF_DARK) >= wanted or lightness >= 0.95:
            return turned
        lightness += 0.02


def _contrast(one: str, other: str) -> float:
    """Return the contrast ratio of two colours (WCAG 2.1)."""

    def luminance(colour: str) -> float:
        parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def _escape(text: object) -> str:
    return html.escape(str(text), quote=True)


def _unbroken(text: str) -> str:
    """Return words whose numbers keep their uncertainty on one line."""
    return text if _NUMBER.fullmatch(text) else text.replace(" ± ", "\u00a0±\u00a0")


def _in_style(text: str) -> str:
    """Return a text as it may stand in a string of a style sheet inside of HTML."""
    return "".join(sign if sign.isalnum() or sign in " .,:-/()" else f"\\{ord(sign):06x}" for sign in text)


def _svg(figure: Figure, alt: str) -> str:
    """Return a figure as SVG whose text is text, without a background, with its meaning for a screen reader."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    from beam_ident.figures.canvas import plain_decades  # here: a page without figures loads no estimators

    plain_decades(figure)
    for patch in (figure.patch, *(axes.patch for axes in figure.axes)):
        patch.set_facecolor("none")
    buffer = io.StringIO()
    settings = {"svg.hashsalt": "beam_ident", "svg.fonttype": "none", "path.simplify": True}
    with rc_context(settings):
        # Figure.savefig draws twice.
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = _compact(re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL))
    label = _escape(alt)
    # The drawing fills its box; its shape stands in viewBox.
    opening = re.sub(r'\s(width|height)="[^"]*"', "", svg[: svg.index(">")])
    return f'{opening} role="img" aria-label="{label}"><title>{label}</title>{svg[svg.index(">") + 1 :]}'


def _compact(svg: str) -> str:
    """Return an SVG in half as many bytes, and the same to the eye: places to 0.01 pt, a style of many marks once."""
    is_exact = False

    def rounded(match: re.Match[str]) -> str:
        # Marks are small, and short; they stand in definitions: their outlines are kept as they are.
        nonlocal is_exact
        if match[0] in ("<defs>", "</defs>"):
            is_exact = match[0] == "<defs>"
        elif not is_exact or len(match[2]) > 1000:
            places = re.sub(r"-?\d+\.\d{3,}", lambda own: f"{float(own[0]):.2f}", match[2])
            letters = re.sub(r"\s*([A-Za-z])\s*", r"\1", places)
            return f'{match[1]}"{letters}"'
        return match[0]

    def hoisted(match: re.Match[str]) -> str:
        styles = set(re.findall(r' style="([^"]*)"', match[2]))
        if len(styles) != 1 or "style=" in match[1] or re.search(r"(^|; )opacity", (style := styles.pop())):
            return match[0]
        marks = match[2].replace(f' style="{style}"', "")
        return f'<g{match[1]} style="{style}">{marks}</g>'

    svg = re.sub(r'</?defs>|( (?:d|x|y)=)"([^"]*)"', rounded, svg)
    return re.sub(r"<g([^>]*)>((?:\s*<use [^>]*/>){2,}\s*)</g>", hoisted, svg)


def _with_own_names(svg: str, number: int) -> str:
    """Return an SVG whose names are its own among all figures of a page; those that nothing refers to go."""
    used = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', svg))

    def named(match: re.Match[str]) -> str:
        return f' id="f{number}-{match[1]}"' if match[1] in used else ""

    svg = re.sub(r' id="([^"]*)"', named, svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\g<1>f{number}-", svg)
    return re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
