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
from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from beam_ident.errors import ReportError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tone = Literal["", "good", "doubt", "bad"]

_STYLE = """
:root{color-scheme:light dark;--ink:#1f2937;--soft:#4b5563;--line:#d1d5db;--paper:#ffffff;--desk:#f3f4f6;
  --link:#1d4ed8;--good:#0b5f58;--good-paper:#ecfdf5;--doubt:#854d0e;--doubt-paper:#fefce8;
  --bad:#9a3412;--bad-paper:#fff7ed}
@media (prefers-color-scheme:dark){:root{--ink:#e5e7eb;--soft:#b4bcc8;--line:#374151;--paper:#111827;
  --desk:#0b0f19;--link:#93c5fd;--good:#6ee7b7;--good-paper:#06281f;--doubt:#fde68a;--doubt-paper:#2b2108;
  --bad:#fdba74;--bad-paper:#2f1508}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--desk);color:var(--ink);overflow-wrap:break-word;
  font:15px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif}
header,nav,main{display:flow-root;max-width:62rem;margin:0 auto;padding:0 2.4rem;background:var(--paper)}
header{padding-top:2.2rem}main{padding-bottom:3rem}
h1{font-size:1.7rem;line-height:1.2;margin:0 0 .4rem}
h2{font-size:1.2rem;margin:2.4rem 0 .6rem;padding-top:.7rem;border-top:1px solid var(--line)}
h3{font-size:1rem;margin:1.6rem 0 .4rem}
p{margin:.5rem 0;max-width:46rem}a{color:var(--link)}
.lead{font-size:1.05rem;max-width:52rem}
nav ol{margin:.8rem 0 0;padding:0;list-style:none;display:flex;flex-wrap:wrap;gap:.15rem 1.1rem;font-size:.9rem}
.box{overflow-x:auto;max-width:100%;margin:1rem 0 1.6rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.88rem;min-width:50%}
caption{text-align:left;color:var(--soft);padding-bottom:.4rem;min-width:16rem}
caption span{position:sticky;left:0;display:inline-block;max-width:min(100%,calc(100vw - 2.2rem))}
th,td{text-align:left;vertical-align:top;padding:.32rem .6rem;border-bottom:1px solid var(--line)}
thead th{color:var(--soft);font-weight:600;vertical-align:bottom}
tbody th{font-weight:600}
.number{text-align:right;white-space:nowrap}
.text{min-width:7rem;max-width:28rem}
tr.chosen>*{background:var(--doubt-paper);font-weight:600}
.good,.doubt,.bad{font-weight:600}.good{color:var(--good)}.doubt{color:var(--doubt)}.bad{color:var(--bad)}
figure{margin:1rem 0 1.8rem}
figure svg{display:block;width:100%;min-width:34rem;height:auto}
figure svg text{fill:var(--ink);font-family:system-ui,"DejaVu Sans",sans-serif!important}
figcaption{color:var(--soft);font-size:.88rem;max-width:46rem}
figure .white svg{background:#fff}figure .white text{fill:#000}
figure .box{margin:0 0 .3rem}
math{font-size:1.1rem}
aside{border-left:4px solid var(--bad);background:var(--bad-paper);padding:.5rem .9rem;margin:.6rem 0;max-width:52rem}
aside.good{border-color:var(--good);background:var(--good-paper)}
aside.doubt{border-color:var(--doubt);background:var(--doubt-paper)}
aside p{margin:.15rem 0;color:var(--ink);font-weight:400}aside p.verdict{font-weight:600}
code{font-size:.92em;overflow-wrap:anywhere}
@media (max-width:48rem){header,nav,main{padding-left:1rem;padding-right:1rem}header{padding-top:1.2rem}}
@page{size:A4;margin:14mm 13mm}
@media print{:root{color-scheme:light;--ink:#000;--soft:#374151;--line:#9ca3af;--paper:#fff;--desk:#fff;
  --link:#000;--good:#0b5f58;--good-paper:#fff;--doubt:#854d0e;--doubt-paper:#fff;--bad:#9a3412;--bad-paper:#fff}
  body{font-size:9.5pt;line-height:1.4}header,nav,main{max-width:none;padding:0}
  caption span{max-width:none}
  .box{overflow:visible}.number{white-space:normal}.text{min-width:0}table{width:100%;font-size:8pt}
  th,td{padding:.2rem .35rem;overflow-wrap:break-word}
  table.wide{font-size:6.6pt}table.wide :is(th,td){padding:.15rem .2rem}
  thead{display:table-header-group}tr,figure,aside,.equation{break-inside:avoid}h2,h3,caption{break-after:avoid}
  figure svg{min-width:0;max-height:235mm}a{text-decoration:none}}
"""

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

    Attributes
    ----------
    figures : dict from name to SVG -- every figure that was given a name, as a file of its own would hold it
    """

    def __init__(self, title: str, lead: str) -> None:
        self.title, self.lead = title, lead
        self.figures: dict[str, str] = {}
        self._head: list[str] = []
        self._sections: list[tuple[str, list[str]]] = []
        self._colours: set[str] = set()
        self._n_boxes = 0
        self._n_figures = 0

    def section(self, heading: str) -> None:
        """Begin a section; what follows belongs to it."""
        self._sections.append((heading, []))

    def subsection(self, heading: str) -> None:
        """Begin a part of the section."""
        self._add(f"<h3>{_escape(heading)}</h3>")

    def paragraph(self, text: str) -> None:
        """Add a paragraph of plain text."""
        self._add(f"<p>{_escape(text)}</p>")

    def link(self, text: str, address: str) -> None:
        """Add a paragraph that is a link, to a file beside the page or into the net."""
        self._add(f'<p><a href="{_escape(address)}">{_escape(text)}</a></p>')

    def warning(self, text: str, remedy: str = "", tone: Tone = "bad") -> None:
        """Add what a reader must not overlook, with what to do about it; a verdict, in a good tone."""
        remedies = f"<p>{_escape(remedy)}</p>" if remedy else ""
        self._add(f'<aside class="{tone}"><p class="verdict">{_escape(text)}</p>{remedies}</aside>')

    def equation(self, mathml: str, text: str) -> None:
        """Add an equation as MathML, the content of ``<math>``, with the words that a screen reader speaks."""
        self._add(
            f'<div class="box equation" role="group" tabindex="0" aria-label="{_escape(text)}">'
            f'<math display="block">{_PARENTHESES.sub(_UPRIGHT, mathml)}</math></div>'
        )

    def table(
        self,
        columns: Sequence[str],
        rows: Sequence[Sequence[str | Cell]],
        caption: str,
        chosen: Container[int] = (),
    ) -> None:
        """Add a table; the first cell of a row is its heading.

        Parameters
        ----------
        columns : sequence of str -- their headings, with the unit
        rows : sequence of sequence of str or Cell -- as long as ``columns``
        caption : str -- a sentence that says what the table means
        chosen : container of int -- indices of the rows that stand out

        Raises
        ------
        ReportError
            A row has another number of cells than there are columns.
        """
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
        kinds = ["number" if number else "text" for number in is_number]
        head = "".join(
            f'<th scope="col" class="{kind}">{_escape(name)}</th>'
            for name, kind in zip(columns, kinds, strict=True)
        )
        body = []
        for number, row in enumerate(cells):
            mark = ' class="chosen"' if number in chosen else ""
            texts = "".join(
                _cell(cell, kind, 'th scope="row"' if k == 0 else "td")
                for k, (cell, kind) in enumerate(zip(row, kinds, strict=True))
            )
            body.append(f"<tr{mark}>{texts}</tr>")
        wide = ' class="wide"' if len(columns) >= _WIDE else ""
        label = f"t{self._count_box()}"
        content = (
            f'<table{wide}><caption id="{label}"><span>{_escape(caption)}</span></caption>'
            f"<thead><tr>{head}</tr></thead><tbody>\n" + "\n".join(body) + "\n</tbody></table>"
        )
        self._add(_box(content, label))

    def figure(self, figure: Figure, caption: str, alt: str, name: str = "", number: str = "") -> None:
        """Add a figure of Matplotlib as SVG.

        Parameters
        ----------
        figure : matplotlib.figure.Figure
        caption : str -- what it means, and where not to trust it
        alt : str -- what it shows, for those who do not see it
        name : str -- its stem where it is also kept in ``figures``
        number : str -- in place of the page's own count, where a page takes over the numbers of another work
        """
        self._n_figures += 1
        svg = _svg(figure, alt)
        if name:
            self.figures[name] = svg
        own, kind = _with_own_names(svg, self._n_figures), " white"
        if "<image" not in svg:  # pictures keep their colours, and white around them
            self._colours |= {colour.lower() for colour in _COLOUR.findall(own)}
            own, kind = _COLOUR.sub(lambda match: f"var(--c{match[0][1:].lower()})", own), ""
        width = float(figure.get_size_inches()[0])
        if width < _NARROW:
            own = own.replace("<svg", f'<svg style="min-width:0;max-width:{width:.2f}in"', 1)
        label = f"t{self._count_box()}"
        words = f"Figure {number or self._n_figures}. {caption}"
        self._add(
            f'<figure>{_box(own, label, kind)}<figcaption id="{label}">{_escape(words)}</figcaption></figure>'
        )

    def text(self) -> str:
        """Return the whole page as HTML."""
        contents = "".join(
            f'<li><a href="#s{number}">{_escape(heading)}</a></li>'
            for number, (heading, _) in enumerate(self._sections, 1)
        )
        nav = f'<nav aria-label="Contents"><ol>{contents}</ol></nav>\n' if len(self._sections) > 3 else ""
        sections = "\n".join(
            f'<section aria-labelledby="s{number}"><h2 id="s{number}">{_escape(heading)}</h2>\n'
            + "\n".join(blocks)
            + "\n</section>"
            for number, (heading, blocks) in enumerate(self._sections, 1)
        )
        head = "\n".join(self._head)
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            '<link rel="icon" href="data:,">'
            f"<title>{_escape(self.title)}</title><style>{_STYLE}{self._palette()}</style></head>\n<body>"
            f'<header><h1>{_escape(self.title)}</h1><p class="lead">{_escape(self.lead)}</p></header>\n'
            f"{nav}<main>\n{head}\n{sections}\n</main></body></html>\n"
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
            self.table([group, "value"], [[key, str(value)] for key, value in entries.items()], f"{group}.")

    def _add(self, block: str) -> None:
        (self._sections[-1][1] if self._sections else self._head).append(block)

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


def _cell(cell: Cell, kind: str, tag: str) -> str:
    text = _escape(cell.text).replace(" ± ", "&nbsp;±&nbsp;" if kind == "text" else " ± ")
    if cell.link:
        text = f'<a href="{_escape(cell.link)}">{text}</a>'
    classes = f"{kind} {cell.tone}".strip()
    return f'<{tag} class="{classes}">{text}</{tag.split()[0]}>'


def _box(content: str, label: str, kind: str = "") -> str:
    """Return a box that scrolls where its content is wider than the page, by keyboard too."""
    return f'<div class="box{kind}" role="group" tabindex="0" aria-labelledby="{label}">{content}</div>'


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
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    label = _escape(alt)
    # The drawing fills its box; its shape stands in viewBox.
    opening = re.sub(r'\s(width|height)="[^"]*"', "", svg[: svg.index(">")])
    return f'{opening} role="img" aria-label="{label}"><title>{label}</title>{svg[svg.index(">") + 1 :]}'


def _with_own_names(svg: str, number: int) -> str:
    """Return an SVG whose names are its own among all figures of a page; those that nothing refers to go."""
    used = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', svg))

    def named(match: re.Match[str]) -> str:
        return f' id="f{number}-{match[1]}"' if match[1] in used else ""

    svg = re.sub(r' id="([^"]*)"', named, svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\g<1>f{number}-", svg)
    return re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
