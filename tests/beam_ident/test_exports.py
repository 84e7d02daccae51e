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

ESTIMATORS_LOAD = {"beam_ident", "numpy", "scipy.linalg", "scipy.optimize", "scipy.special", "scipy.fft"}
"""What all public names together may load, and what these load themselves."""
NOT_FOR_A_FIT = {"multiprocessing", "asyncio", "concurrent.futures.process", "argparse", "subprocess"}
"""Modules of Python that are slow to load, and wait for who needs them."""


def loaded_after(statement: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after a statement."""
    code = f"{statement}\nimport sys\nprint(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(ran.stdout.split())


@pytest.mark.parametrize("name", beam_ident.__all__)
def test_every_exported_name_is_there(name: str) -> None:
    assert not inspect.ismodule(getattr(beam_ident, name))
    assert name in dir(beam_ident)


def test_type_checkers_see_every_name_as_itself() -> None:
    tree = ast.parse(Path(beam_ident.__file__).with_suffix(".pyi").read_text())
    imports = [alias for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert all(alias.name == alias.asname for alias in imports)
    assert sorted(alias.name for alias in imports) == beam_ident.__all__


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


@pytest.mark.slow
def test_all_estimators_together_load_linear_algebra_and_optimisation_and_nothing_heavier() -> None:
    # In one interpreter: what any one name loads is among it.
    first = f"import {', '.join(sorted(ESTIMATORS_LOAD))}; import sys; known = set(sys.modules)"
    every = "for name in beam_ident.__all__: getattr(beam_ident, name)"
    loaded = loaded_after(f"{first}\n{every}\nfor name in known - {{'sys'}}: del sys.modules[name]")
    assert "beam_ident.modal_identification.time_domain" in loaded
    others = {name for name in loaded if name.partition(".")[0] not in sys.stdlib_module_names}
    assert {name for name in others if not name.startswith("beam_ident.")} == set()
    assert not NOT_FOR_A_FIT & loaded
