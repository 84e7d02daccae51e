from __future__ import annotations

import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure

from beam_ident.errors import ReportError
from beam_ident.report.page import Cell, Page, dark_of

VOID = {"meta", "link"}


def drawing(colour: str = "#1d4ed8") -> Figure:
    figure = Figure(figsize=(7.0, 3.0))
    axis = figure.subplots()
    axis.plot([0.0, 1.0], [0.0, 1.0], color=colour)
    axis.set_xlabel("time [s]")
    return figure


def full_page() -> Page:
    page = Page("A <page> & more", "One sentence.")
    page.warning("It can be trusted.", tone="good")
    page.section("Numbers")
    page.paragraph("x < y")
    page.table(
        ["mode", "f [Hz]", "verdict"],
        [["1", "4.384 ± 0.001", Cell("passed", "good")], ["2", "–", Cell("failed", "bad", "other.html")]],
        "What was found.",
        chosen=[1],
    )
    page.equation("<mi>y</mi><mo>=</mo><mi>u</mi>", "y equals u")
    page.section("Pictures")
    page.figure(drawing(), "A line. It means nothing.", "a rising line", name="line")
    page.figure(drawing(), "The same again.", "a rising line")
    return page


class Balance(HTMLParser):
    """Fails at the first tag that does not close what was opened last; collects what refers to what."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.wanted: list[str] = []

    def handle_starttag(self, tag, attrs):
        own = dict(attrs)
        self.ids += [own["id"]] if "id" in own else []
        self.wanted += [own["aria-labelledby"]] if "aria-labelledby" in own else []
        self.wanted += [own["href"][1:]] if own.get("href", "").startswith("#") else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_a_page_is_well_formed_and_every_reference_has_one_target():
    text = full_page().text()
    reader = Balance()
    reader.feed(text)
    assert reader.open == []
    assert len(reader.ids) == len(set(reader.ids))
    assert set(reader.wanted) <= set(reader.ids)
    assert set(re.findall(r"url\(#([^)]+)\)", text)) <= set(reader.ids)


def test_a_page_asks_for_nothing_else_and_escapes_what_it_is_given():
    text = full_page().text()
    assert "A &lt;page&gt; &amp; more" in text
    assert "x &lt; y" in text
    assert set(re.findall(r'(?:src|href)="([^"#][^"]*)"', text)) == {"data:,", "other.html"}
    assert "http" not in text


def test_tables_have_a_caption_and_headings_of_rows_and_columns():
    text = full_page().text()
    assert text.count('<th scope="col"') == 3
    assert text.count('<th scope="row"') == 2
    assert "What was found.</span></caption>" in text
    assert re.search(r'<td class="number">4.384 ± 0.001</td>', text)
    assert '<tr class="chosen">' in text
    assert '<td class="text bad"><a href="other.html">failed</a></td>' in text


def test_figures_keep_their_text_and_say_what_they_show():
    page = full_page()
    text = page.text()
    assert text.count('role="img" aria-label="a rising line"') == 2
    assert "time [s]</text>" in text
    assert "Figure 2. The same again." in text
    assert list(page.figures) == ["line"]
    alone = ElementTree.fromstring(page.figures["line"])
    assert alone.tag.endswith("svg")
    assert "#1d4ed8" in page.figures["line"]


def test_a_drawing_of_many_marks_is_small_and_each_stands_where_it_belongs():
    figure = Figure(figsize=(4.0, 3.0))  # 288 x 216 pt
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    x, y = np.random.default_rng(1).uniform(0.1, 0.9, (2, 500))
    axes.plot(x, y, "o", markersize=2.0, color="#1d4ed8")
    axes.plot(x[:200], y[:200], color="#b45309")
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), xticks=[], yticks=[])
    page = Page("A page", "One sentence.")
    page.figure(figure, "Many marks.", "many marks", name="marks")
    drawn = ElementTree.fromstring(page.figures["marks"])
    marks = [own.attrib for own in drawn.iter() if own.tag.endswith("use")]
    places = np.array([[float(own["x"]), float(own["y"])] for own in marks])
    np.testing.assert_allclose(places, np.stack([288.0 * x, 216.0 * (1.0 - y)], axis=1), atol=0.0051)
    assert len(page.figures["marks"]) < 60 * 700  # bytes for a mark, or a point of the line
    assert all("style" not in own for own in marks)
    outlines = (own.get("d", "") for own in drawn.iter() if own.tag.endswith("path"))
    line = np.array([pair.split() for pair in re.split("[ML]", max(outlines, key=len))[1:]], dtype=float)
    assert len(line) > 150  # points between which a line is straight to the eye are left out
    apart = np.abs(line[:, None] - np.stack([288.0 * x, 216.0 * (1.0 - y)], axis=1)[None]).max(axis=2)
    assert np.max(apart.min(axis=1)) < 0.0051


def test_colours_of_figures_follow_the_scheme_of_the_reader_but_not_those_of_pictures():
    page = full_page()
    assert "stroke: var(--c1d4ed8)" in page.text()
    assert page.text().count("--c1d4ed8:#1d4ed8") == 2  # on screen and on paper
    picture = Figure(figsize=(3.0, 3.0))
    picture.subplots().imshow(np.eye(3))
    page.figure(picture, "Cells.", "three cells")
    assert 'class="box white"' in page.text()


def luminance(colour: str) -> float:
    parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("colour", ["#1d4ed8", "#c2410c", "#0f766e", "#7e22ce", "#a16207", "#000000"])
def test_what_can_be_read_on_white_can_be_read_on_a_dark_page(colour):
    on_dark = (luminance(dark_of(colour)) + 0.05) / (luminance("#111827") + 0.05)
    assert 1.05 / (luminance(colour) + 0.05) > 4.5
    assert on_dark > 4.5


def test_a_faint_grid_stays_faint_on_a_dark_page():
    ratio = (luminance(dark_of("#e5e7eb")) + 0.05) / (luminance("#111827") + 0.05)
    assert 1.05 < ratio < 1.6


def test_a_row_of_another_length_is_refused():
    with pytest.raises(ReportError, match="row 1 of the table 'T' has 1 cells; expected 2"):
        Page("t", "l").table(["a", "b"], [["1", "2"], ["3"]], "T")


def test_a_column_without_a_heading_is_refused():
    with pytest.raises(
        ReportError, match="the table 'T' has the columns '', 'b'; expected a heading for each"
    ):
        Page("t", "l").table(["", "b"], [["1", "2"]], "T")


def test_nothing_is_overwritten_unless_it_is_allowed(tmp_path):
    path = tmp_path / "deeper" / "page.html"
    assert Page("first", "l").write(path) == path
    with pytest.raises(ReportError, match="is there already"):
        Page("second", "l").write(path)
    assert "first" in path.read_text()
    Page("second", "l").write(path, overwrite=True)
    assert "second" in path.read_text()
    assert [p.name for p in path.parent.iterdir()] == ["page.html"]


def test_a_page_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    page = Page("t", "l")
    page.section("one lone surrogate \udc80")
    with pytest.raises(UnicodeEncodeError):
        page.write(tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []
