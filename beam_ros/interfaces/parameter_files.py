"""Parameter files: the YAML that nodes and commands read, and the packaged one that holds every default."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces.parameter import Value
from beam_ros.interfaces.rig_parameters import check_parameters

_SHAPE = "expected `/**:` with `ros__parameters:` below it, as in the packaged rig.yaml"


def flatten(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values of nested mappings, in their order."""
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flatten(value, f"{name}.")
        else:
            yield name, value


def read_yaml(path: Path) -> Any:
    """Read one YAML file.

    Raises
    ------
    ParameterFileError
        The file is missing, cannot be read, or is no YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as err:
        raise ParameterFileError(f"{path}: no such file; give the path of an existing YAML file") from err
    except (OSError, UnicodeDecodeError) as err:
        raise ParameterFileError(f"{path}: cannot be read as text ({err}); expected a YAML file") from err
    try:
        return YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError) as err:
        place = getattr(err, "problem_mark", None)
        where = f" in line {place.line + 1}" if place is not None else ""
        problem = getattr(err, "problem", None) or str(err).splitlines()[0]
        raise ParameterFileError(f"{path}: no valid YAML{where}: {problem}; mend that line") from err


def parameter_sections(path: Path) -> dict[str, Mapping[str, Any]]:
    """Read a ROS parameter file: what stands below ``ros__parameters:`` for each node.

    Raises
    ------
    ParameterFileError
        The file is missing or has another form.
    """
    document = read_yaml(path)
    if not isinstance(document, Mapping) or not document:
        raise ParameterFileError(f"{path}: holds no parameters; {_SHAPE}")
    try:
        return dict(_sections(document))
    except ParameterFileError as err:
        raise ParameterFileError(f"{path}: {err}; {_SHAPE}") from err


def _sections(tree: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield what stands below every ``ros__parameters:``, whose node may be named at several levels."""
    for key, section in tree.items():
        name = f"{prefix}{key}"
        if not isinstance(section, Mapping) or not section:
            raise ParameterFileError(f"section {name!r} is no set of ROS parameters")
        if "ros__parameters" not in section:
            yield from _sections(section, f"{name}/")
        elif not isinstance(section["ros__parameters"], Mapping):
            raise ParameterFileError(f"section {name!r} has an empty `ros__parameters:`")
        elif len(section) > 1:
            raise ParameterFileError(f"section {name!r} holds more than `ros__parameters:`")
        else:
            yield name, section["ros__parameters"]


def parameters_in_file(path: Path) -> dict[str, Value]:
    """Read a ROS parameter file and check what it gives under ``/**``.

    Parameters
    ----------
    path : Path -- a file of the form ``/**: {ros__parameters: {...}}``

    Returns
    -------
    dict -- dotted names and values, only those that the file holds

    Raises
    ------
    ParameterFileError
        The file is missing, has another form, or holds an unknown key, a wrong type, unit or range.
    """
    sections = parameter_sections(path)
    if set(sections) != {"/**"}:
        raise ParameterFileError(
            f"{path}: has sections {', '.join(sections)}; a rig file has `/**` alone, so that every node and command "
            f"reads the same: move the others into it; {_SHAPE}"
        )
    try:
        return check_parameters(dict(flatten(sections["/**"])))
    except ParameterFileError as err:
        raise ParameterFileError(f"{path}: {err}") from err


def packaged_rig_file() -> Path:
    """Path of the packaged ``rig.yaml``, which holds every parameter's default."""
    return Path(str(resources.files("beam_ros"))) / "config" / "rig.yaml"


def packaged_defaults() -> dict[str, Value]:
    """Every parameter's default, read from the packaged file."""
    return dict(_packaged())


@cache
def _packaged() -> Mapping[str, Value]:
    return parameters_in_file(packaged_rig_file())


def in_present_words(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return the nested parameters of an earlier version of the suite, as bags hold them, in today's names."""
    simulation = dict(tree.get("simulation", {}))
    # In bags of version 0.1 one switch stood for drag with C_d = 2 and the cubic terms.
    if simulation.pop("realistic", False):
        simulation = {"drag_coefficient": 2.0, "large_deflections": True, **simulation}
    return {**tree, "simulation": simulation}
