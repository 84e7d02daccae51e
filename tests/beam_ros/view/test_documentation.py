"""The page `docs/view.md` says what the code does."""

from __future__ import annotations

import argparse
from pathlib import Path

from beam_ros.cli.live import up, view
from beam_ros.view.server import DEFAULT_HOST, Limits

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "view.md").read_text(encoding="utf-8")


def test_the_numbers_of_the_page_are_those_of_the_server():
    limits = Limits()
    assert f"{limits.readers} readers and {limits.connections} connections" in PAGE
    assert f"more than {limits.frame_bytes} bytes" in PAGE
    assert limits.pictures_hz == 10.0
    assert "at most ten a second" in PAGE


def test_the_page_names_the_default_port_and_both_verbs_take_it():
    for verb, words in ((view, []), (up, ["--rig", "simulated"])):
        parser = argparse.ArgumentParser()
        verb.add_arguments(parser)
        given = parser.parse_args(words)
        assert f"http://localhost:{given.port}/" in PAGE
        assert given.host == DEFAULT_HOST


def test_every_section_of_the_page_in_the_browser_is_explained():
    html = (Path(view.__file__).parents[2] / "view" / "page" / "page.html").read_text(encoding="utf-8")
    for line in html.splitlines():
        if "<h2 " in line:
            heading = line.partition(">")[2].partition("<")[0].partition(", the last")[0]
            assert heading in PAGE, heading
