"""What ``import beam_ident`` offers: every name, at the cost of none."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import beam_ident


def names_for_type_checkers() -> set[str]:
    """Names imported under TYPE_CHECKING, each as itself."""
    tree = ast.parse(Path(beam_ident.__file__).read_text())
    blocks = [node for node in tree.body if isinstance(node, ast.If)]
    found = [
        a for block in blocks for node in block.body if isinstance(node, ast.ImportFrom) for a in node.names
    ]
    assert all(a.name == a.asname for a in found)
    return {a.name for a in found}


def loaded_after(statement: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after a statement."""
    code = f"{statement}\nimport sys\nprint(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(ran.stdout.split())


@pytest.mark.parametrize("name", beam_ident.__all__)
def test_every_exported_name_is_there(name: str) -> None:
    assert not inspect.ismodule(getattr(beam_ident, name))
    assert name in dir(beam_ident)


def test_type_checkers_see_the_names_that_are_loaded() -> None:
    assert names_for_type_checkers() == set(beam_ident.__all__)


def test_no_module_hides_an_exported_name() -> None:
    # Loading beam_ident.x puts the module x into the package, over a function of the same name.
    modules = {module.name for module in pkgutil.iter_modules(beam_ident.__path__)}
    assert not modules & set(beam_ident.__all__)


def test_a_name_that_is_not_there_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        _ = beam_ident.identfy  # type: ignore[attr-defined]


def test_records_and_excitations_do_not_wait_for_scipy() -> None:
    loaded = loaded_after(
        "from beam_ident import AxisLimits, LogChirp, Multisine, Recipe, TimeRecord, InputSignal"
    )
    assert not {name for name in loaded if name.partition(".")[0] == "scipy"}


def test_the_package_itself_loads_no_more_than_its_own_names() -> None:
    loaded = loaded_after("import beam_ident")
    assert {name for name in loaded if name.partition(".")[0] == "beam_ident"} == {"beam_ident"}
    assert not {"numpy", "scipy.signal", "scipy.stats"} & loaded
