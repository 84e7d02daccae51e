from __future__ import annotations

from pathlib import Path

import pytest

from beam_ident.plug_ins import find_kind, plug_ins

GROUP = "beam_ident.toys"
TABLE = {"beam": "the suite's own", "csv": "another one"}, GROUP, LookupError, ImportError


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package on the path that adds three kinds, one of which cannot be imported."""
    (tmp_path / "toys.py").write_text("plough = 'from the package'\n")
    metadata = tmp_path / "toys-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: toys\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        f"[{GROUP}]\nplough = toys:plough\nbroken = toys:missing\nabsent = no_such_module:x\nbeam = toys:plough\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))


def test_a_kind_comes_from_the_table_or_from_a_package(toys: None) -> None:
    assert find_kind("axis.kind", "csv", *TABLE) == "another one"
    assert find_kind("axis.kind", "plough", *TABLE) == "from the package"


def test_a_package_replaces_no_kind_of_the_suite(toys: None) -> None:
    assert "beam" in plug_ins(GROUP)
    assert find_kind("axis.kind", "beam", *TABLE) == "the suite's own"


def test_packages_are_looked_up_only_when_the_table_does_not_have_the_kind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.metadata.entry_points", None)
    assert find_kind("axis.kind", "beam", *TABLE) == "the suite's own"


def test_an_unknown_kind_is_answered_with_the_likeliest_one_and_the_list(toys: None) -> None:
    with pytest.raises(LookupError) as refusal:
        find_kind("axis.kind", "plow", *TABLE)
    assert str(refusal.value) == (
        "axis.kind is 'plow': expected one of beam, csv, absent, broken, plough; did you mean 'plough'?"
    )
    with pytest.raises(LookupError, match=r"entry point of beam_ident\.toys"):
        find_kind("axis.kind", "zzzzz", *TABLE)


@pytest.mark.parametrize("name", ["broken", "absent"])
def test_a_package_that_cannot_be_imported_is_named(toys: None, name: str) -> None:
    with pytest.raises(ImportError, match=rf"axis\.kind is '{name}'.*install that package anew"):
        find_kind("axis.kind", name, *TABLE)
