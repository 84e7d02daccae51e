"""A page of the suite in a real browser: what it asks for, what it complains of, what it cuts off."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from beam_ros.errors import UsageError
from beam_ros.reporting.printing import find_browser

WIDTHS = (360, 768, 1280)
A4_PX = round((210 - 2 * 13) / 25.4 * 96)  # between the margins, at 96 px an inch
CUT_OFF = """
() => {
  const found = [];
  const edge = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > edge) found.push('the page is wider than the screen');
  const parts = 'table, figure svg, p, h1, h2, figcaption, aside, .equation math';
  for (const element of document.querySelectorAll(parts)) {
    const box = element.closest('.box');
    const right = element.getBoundingClientRect().right;
    const scrolls = box && getComputedStyle(box).overflowX !== 'visible';
    if (right > edge + 1 && !scrolls) found.push(element.tagName + ': ' + element.textContent.slice(0, 60));
    if (scrolls && box.getBoundingClientRect().right > edge + 1) found.push('box: ' + box.textContent.slice(0, 60));
  }
  for (const cell of document.querySelectorAll('th, td, caption')) {
    if (cell.scrollWidth > cell.clientWidth + 1) found.push('cell: ' + cell.textContent.slice(0, 60));
  }
  return found;
}
"""


@contextmanager
def open_browser() -> Iterator[Any]:
    """Start an installed Chromium without a window; skip the test where there is none."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="no Playwright: the extra `browser` brings it"
    )
    pytest.importorskip("axe_playwright_python", reason="no axe-core: the extra `browser` brings it")
    try:
        executable = find_browser()
    except UsageError as err:
        pytest.skip(str(err))
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield browser
        browser.close()


def faults_of_page(browser: Any, path: Path) -> list[str]:
    """Return what is wrong with a page: at every width, in light and dark, in A4, and for axe-core."""
    from axe_playwright_python.sync_playwright import Axe

    faults = []
    for scheme in ("light", "dark"):
        context = browser.new_context(color_scheme=scheme)
        page = context.new_page()
        said: list[str] = []
        page.on("console", lambda message, said=said: said.append(f"console: {message.text}"))
        page.on("pageerror", lambda error, said=said: said.append(f"error: {error}"))
        asked: list[str] = []
        page.on("request", lambda request, asked=asked: asked.append(request.url))
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 900})
            page.goto(path.resolve().as_uri())
            faults += [f"{scheme}, {width} px: {fault}" for fault in page.evaluate(CUT_OFF)]
            for violation in Axe().run(page).response["violations"]:
                first = violation["nodes"][0]["html"][:120]
                faults.append(f"{scheme}, {width} px: {violation['id']}: {violation['help']}: {first}")
        faults += said
        faults += [
            f"asked for {url[:120]}" for url in asked if url != path.resolve().as_uri() and url != "data:,"
        ]
        page.emulate_media(media="print")
        page.set_viewport_size({"width": A4_PX, "height": 900})
        faults += [f"{scheme}, A4: {fault}" for fault in page.evaluate(CUT_OFF)]
        context.close()
    return faults
