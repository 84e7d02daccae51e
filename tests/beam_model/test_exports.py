"""What ``import beam_model`` offers: every name, at the cost of none."""

import inspect
import pkgutil
import subprocess
import sys

import pytest

import beam_model


@pytest.mark.parametrize("name", beam_model.__all__)
def test_every_exported_name_is_there(name: str) -> None:
    assert not inspect.ismodule(getattr(beam_model, name))
    assert name in dir(beam_model)


def test_no_module_hides_an_exported_name() -> None:
    # Loading beam_model.x puts the module x into the package, over a function of the same name.
    assert not {module.name for module in pkgutil.iter_modules(beam_model.__path__)} & set(beam_model.__all__)


def test_a_name_that_is_not_there_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'BeamModle'"):
        _ = beam_model.BeamModle  # type: ignore[attr-defined]


def test_parameters_and_errors_do_not_wait_for_scipy() -> None:
    code = "from beam_model import BeamModelError, BeamParameters, Damping; import sys; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert "beam_model.parameters" in ran.stdout.split()
    assert not {name for name in ran.stdout.split() if name.partition(".")[0] == "scipy"}
