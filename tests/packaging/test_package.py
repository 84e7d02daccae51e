"""What setup.py, package.xml, the executables and the tree say about one another agrees."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import tempfile
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from beam_ros.errors import UsageError
from beam_ros.interfaces.graph import NODES, RigKind, nodes_of_rig
from beam_ros.process.executables import MODULES
from beam_ros.rig.rig import Rig
from tests.packaging.conftest import ROOT

PACKAGES = ("beam_ros", "beam_model", "beam_ident")

ROSDEP_KEYS = {  # top-level module: key in package.xml; None: from PyPI only, or part of another
    "numpy": "python3-numpy",
    "aiohttp": "python3-aiohttp",
    "scipy": "python3-scipy",
    "jinja2": "python3-jinja2",
    "matplotlib": "python3-matplotlib",
    "cv2": "python3-opencv",
    "serial": "python3-serial",
    "tqdm": "python3-tqdm",
    "ruamel": "python3-ruamel.yaml",
    "rosbags": "python3-rosbags-pip",
    "mcap": "mcap-ros2-support",  # which brings it
    "control": None,
    "distributed": None,
    "numba": None,  # makes stepping and tracking quicker where it is
    "pyarrow": None,  # the table of a study, where it is
    "pyuff": None,  # measurements of other programs, where these are
    "nptdms": None,
    "h5py": None,
    "fsspec": None,  # bags in an object store, where it is
}


def manifest() -> ElementTree.Element:
    """The root of package.xml."""
    return ElementTree.parse(ROOT / "package.xml").getroot()


def imported_modules() -> set[str]:
    """Top-level names that the packages import from outside."""
    found = set()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    found |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                    found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - set(PACKAGES)


def test_setup_and_manifest_agree_on_name_version_and_licence(setup_arguments: dict[str, Any]) -> None:
    root = manifest()
    assert root.get("format") == "3"
    assert root.findtext("export/build_type") == "ament_python"
    for tag in ("name", "version", "license"):
        assert root.findtext(tag) == setup_arguments[tag]
    assert "Apache License" in (ROOT / "LICENSE").read_text()


@pytest.mark.slow
def test_the_manifest_names_every_package_that_is_imported() -> None:
    keys = {element.text for element in manifest().iter("exec_depend")}
    wanted = {ROSDEP_KEYS.get(module, module) for module in imported_modules()} - {None}
    assert wanted <= keys


def test_the_core_requires_nothing_but_the_pure_core(setup_arguments: dict[str, Any]) -> None:
    names = {requirement.split(">")[0] for requirement in setup_arguments["install_requires"]}
    assert names == {"numpy", "scipy", "rosbags", "mcap", "ruamel.yaml", "tqdm", "jinja2", "matplotlib"}


def test_the_ros_wheels_are_pinned_to_jazzy_and_to_where_they_exist(setup_arguments: dict[str, Any]) -> None:
    extras = setup_arguments["extras_require"]
    wheels = [requirement for requirement in extras["ros"] if requirement.startswith("ros-")]
    assert [wheel.partition(";")[0] for wheel in wheels] == [
        "ros-rclpy[fastrtps]==7.1.6",
        "ros-common-interfaces==5.3.6",
    ]
    assert all("x86_64" in wheel and "Linux" in wheel for wheel in wheels)
    assert set(extras["rig"]) < set(extras["ros"])


def test_every_node_of_the_table_has_an_executable(setup_arguments: dict[str, Any]) -> None:
    scripts = dict(line.split(" = ") for line in setup_arguments["entry_points"]["console_scripts"])
    assert set(scripts) == set(MODULES) == {"beam", *NODES}
    assert scripts == {name: f"beam_ros.process.executables:{name}" for name in scripts}


def test_every_module_is_found_by_setuptools_and_typed(setup_arguments: dict[str, Any]) -> None:
    for package in PACKAGES:
        assert (ROOT / package / "py.typed").exists()
        for path in (ROOT / package).rglob("*.py"):
            dotted = ".".join(path.parent.relative_to(ROOT).parts)
            assert dotted in setup_arguments["packages"], f"{path} has no __init__.py beside it"


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[Any]]:
    """Give what a launch file declares; stand-ins record it, since `launch` and `launch_ros` have no wheels."""

    class Recorder:
        def __init__(self, *values: Any, **named: Any) -> None:
            self.values, self.named = values, named

        def perform(self, context: dict[str, str]) -> str:
            return context[self.values[0]]

    modules = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction"),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for name, contents in modules.items():
        module = types.ModuleType(name)
        for content in contents:
            setattr(module, content, Recorder)
        monkeypatch.setitem(sys.modules, name, module)

    def actions_of(name: str) -> list[Any]:
        content = runpy.run_path(str(ROOT / "launch" / name))
        actions: list[Any] = content["generate_launch_description"]().values[0]
        return actions

    return actions_of


@pytest.fixture
def launch_actions(launch_file: Callable[[str], list[Any]]) -> list[Any]:
    """What the rig's launch file declares."""
    return launch_file("rig.launch.py")


def launched(actions: list[Any], **given: str) -> list[Any]:
    """The nodes that the launch file starts with some arguments."""
    declared = {
        action.values[0]: action.named.get("default_value", "") for action in actions if action.values
    }
    nodes: list[Any] = actions[-1].named["function"]({**declared, **given})
    return nodes


@pytest.mark.parametrize("rig", list(RigKind))
def test_the_launch_file_starts_the_rig_of_the_table(
    rig: RigKind, launch_actions: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    arguments = {action.values[0]: action.named for action in launch_actions if action.values}
    assert arguments["rig"]["choices"] == ["simulated", "emulated", "real"]
    assert Path(arguments["params_file"]["default_value"]).exists()

    rig_file = tmp_path.parent / "rig.yaml"
    rig_file.write_text("/**: {ros__parameters: {serial: {port: /dev/ttyACM0}}}")
    nodes = launched(launch_actions, rig=rig.value, params_file=str(rig_file))
    assert tuple(node.named["executable"] for node in nodes) == nodes_of_rig(rig)
    assert [node.named["name"] for node in nodes] == [NODES[name].name for name in nodes_of_rig(rig)]
    assert not any(node.named["parameters"][-1]["use_sim_time"] for node in nodes)
    assert list(tmp_path.iterdir()) == [], "what launching makes itself, nobody takes away"


def test_the_launch_file_lets_only_the_simulated_rig_run_in_another_time(
    launch_actions: list[Any], tmp_path: Path
) -> None:
    slow = tmp_path / "slow.yaml"
    slow.write_text("/**: {ros__parameters: {simulation: {real_time_factor: 0.5}}}")
    nodes = launched(launch_actions, rig="simulated", params_file=str(slow))
    follow = {node.named["executable"]: node.named["parameters"][-1]["use_sim_time"] for node in nodes}
    assert follow == {"simulator": False, "vision_tracker": True, "excitation_generator": True}
    for rig in ("emulated", "real"):
        with pytest.raises(UsageError, match=r"real_time_factor is 0\.5 .* expected 1"):
            launched(launch_actions, rig=rig, params_file=str(slow))


def test_the_launch_file_refuses_what_beam_up_refuses(launch_actions: list[Any], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"serial\.port"):
        launched(launch_actions, rig="real")
    with pytest.raises(UsageError, match="exists already"):
        launched(launch_actions, rig="simulated", record="true", bag=str(tmp_path))
    *nodes, recorder = launched(launch_actions, rig="simulated", record="true", bag=str(tmp_path / "run"))
    assert tuple(node.named["executable"] for node in nodes) == nodes_of_rig(RigKind.SIMULATED)
    assert recorder.named["executable"] == "bag_recorder"
    assert {"recorder.path": str(tmp_path / "run")} in recorder.named["parameters"]


def test_recorder_and_player_have_launch_files_that_give_parameters_of_their_nodes(
    launch_file: Callable[[str], list[Any]], tmp_path: Path
) -> None:
    (recorder,) = launched(launch_file("record.launch.py"), bag=str(tmp_path / "run"), images="true")
    (player,) = launched(launch_file("replay.launch.py"), bag=str(tmp_path), start="2.5", loop="true")
    for node in (recorder, player):
        given = node.named["parameters"][-1]
        assert set(given) <= set(NODES[node.named["executable"]].parameters)
        Rig.from_file().with_values(given)
    assert recorder.named["parameters"][-1]["recorder.images"] is True
    assert player.named["parameters"][-1]["player.start"] == 2.5
    with pytest.raises(UsageError, match="exists already"):
        launched(launch_file("record.launch.py"), bag=str(tmp_path))


def test_every_line_of_the_udev_rule_matches_a_device_and_assigns_something() -> None:
    lines = (ROOT / "beam_ros" / "config" / "70-beam-axis.rules").read_text().splitlines()
    rules = [line for line in lines if line and not line.startswith("#")]
    assert len(rules) == 4
    term = re.compile(r'([A-Z_]+(?:\{[^}]+\})?)(==|\+=|=)"([^"]*)"')
    for rule in rules:
        terms = [term.fullmatch(word) for word in rule.split(", ")]
        assert all(terms), rule
        operators = [match[2] for match in terms if match]
        assert operators == sorted(operators, key=lambda operator: operator != "=="), "matches come first"
        assert {"==", "="} <= set(operators)
