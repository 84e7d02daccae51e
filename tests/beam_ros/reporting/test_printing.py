from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.errors import RigUnavailableError, UsageError
from beam_ros.reporting.printing import BROWSERS, find_browser, print_pdf


def test_without_a_browser_it_is_said_which_would_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="chromium"):
        find_browser()


def test_a_browser_that_fails_is_an_error_with_its_own_last_words(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    broken = tmp_path / BROWSERS[0]
    broken.write_text("#!/bin/sh\necho 'no display' >&2\nexit 3\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    page = tmp_path / "page.html"
    page.write_text("<!doctype html><title>t</title>")
    with pytest.raises(RigUnavailableError, match="no display"):
        print_pdf(page, tmp_path / "page.pdf")


def test_a_page_is_printed_by_an_installed_browser(tmp_path: Path) -> None:
    try:
        find_browser()
    except UsageError as err:
        pytest.skip(str(err))
    page = tmp_path / "page.html"
    page.write_text("<!doctype html><html lang=en><title>t</title><p>printed</p></html>")
    assert print_pdf(page, tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
