"""Who may read the page, by headers alone."""

from __future__ import annotations

import itertools

import pytest

from beam_ros.view.admission import Admission, is_loopback, reachable_name


def admission(host: str = "127.0.0.1") -> tuple[Admission, list[str]]:
    tokens: list[str] = []
    numbers = itertools.count()
    return Admission(host, tokens.append, lambda: f"secret {next(numbers)}"), tokens


OURS = [
    ("localhost:8350", "http://localhost:8350"),
    ("127.0.0.1:8350", "http://127.0.0.1:8350"),
    ("[::1]:8350", "http://[::1]:8350"),
    ("localhost:9000", "http://localhost:9000"),  # forwarded by ssh
    ("localhost", "https://localhost"),
]
FOREIGN = [
    ("localhost:8350", "http://evil.example"),
    ("localhost:8350", "http://localhost:8351"),
    ("localhost:8350", "http://localhost.evil.example:8350"),
    ("localhost:8350", "null"),
    ("localhost:8350", None),
    ("evil.example:8350", "http://evil.example:8350"),
    ("192.168.0.7:8350", "http://192.168.0.7:8350"),
    ("localhost@evil.example", "http://localhost@evil.example"),
    ("", ""),
    (None, "http://localhost:8350"),
    ("[::1", "http://[::1"),
]


@pytest.mark.parametrize(("host", "origin"), OURS)
def test_this_computers_own_page_is_admitted(host, origin):
    assert admission()[0].refusal(host, origin, needs_origin=True) == ""


@pytest.mark.parametrize(("host", "origin"), FOREIGN)
def test_a_strangers_page_and_a_foreign_name_are_refused(host, origin):
    assert "expected" in admission()[0].refusal(host, origin, needs_origin=True)


def test_an_address_is_a_name_of_a_server_for_others_but_a_foreign_name_is_not():
    served, _ = admission("0.0.0.0")
    assert served.refusal("192.168.0.7:8350", "http://192.168.0.7:8350", needs_origin=True) == ""
    assert served.refusal("evil.example:8350", "http://evil.example:8350", needs_origin=True)


def test_this_computer_alone_needs_no_session():
    served, tokens = admission()
    assert tokens == []
    assert served.knows(None)
    assert served.redeem("") == ""


def test_a_token_opens_one_session_once_and_the_next_one_is_there_at_once():
    served, tokens = admission("0.0.0.0")
    assert not served.knows(None)
    assert not served.knows("")
    session = served.redeem(tokens[0])
    assert served.knows(session)
    assert not served.knows(tokens[0])
    assert served.redeem(tokens[0]) == ""
    second = served.redeem(tokens[-1])
    assert second not in ("", session)
    assert served.knows(session)
    assert len(set(tokens)) == len(tokens) == 3


def test_a_wrong_token_opens_nothing_and_changes_nothing():
    served, tokens = admission("0.0.0.0")
    for wrong in ("", "x", tokens[0][:-1], tokens[0] + " ", "ü"):
        assert served.redeem(wrong) == ""
    assert len(tokens) == 1


@pytest.mark.parametrize(
    ("host", "alone"),
    [
        ("127.0.0.1", True),
        ("localhost", True),
        ("::1", True),
        ("0.0.0.0", False),
        ("::", False),
        ("rig.lab", False),
    ],
)
def test_a_server_that_others_reach_is_told_from_one_that_they_do_not(host, alone):
    assert is_loopback(host) == alone
    assert (reachable_name(host) == "localhost") == alone
