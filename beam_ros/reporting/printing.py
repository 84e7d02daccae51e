"""A page printed to PDF by a browser that is installed."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from beam_ros.errors import RigUnavailableError, UsageError

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "microsoft-edge",
    "msedge",
)
_PATIENCE_S = 120.0


def find_browser() -> str:
    """Return the path of a browser that prints without a window.

    Raises
    ------
    UsageError
        None is installed.
    """
    for name in BROWSERS:
        found = shutil.which(name)
        if found:
            return found
    raise UsageError(
        f"--pdf: no browser that can print was found; expected one of {', '.join(BROWSERS)} on the path: install "
        "Chromium, or leave --pdf out and print the page from any browser"
    )


def print_pdf(page: Path, target: Path) -> Path:
    """Print a page to a file.

    Raises
    ------
    UsageError
        No browser is installed.
    RigUnavailableError
        The browser did not print.
    """
    browser = find_browser()
    with tempfile.TemporaryDirectory(prefix="beam-print-") as profile:
        command = [
            browser,
            "--headless",
            "--disable-gpu",
            "--no-first-run",
            "--no-sandbox",
            "--no-pdf-header-footer",
            f"--user-data-dir={profile}",
            f"--print-to-pdf={target.resolve()}",
            page.resolve().as_uri(),
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
        except subprocess.TimeoutExpired as err:
            raise RigUnavailableError(
                f"{browser} did not print {page} within {_PATIENCE_S:g} s; print the page from the browser itself"
            ) from err
    if done.returncode != 0 or not target.exists():
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise RigUnavailableError(
            f"{browser} did not print {page} ({last}); print the page from the browser itself"
        )
    return target
