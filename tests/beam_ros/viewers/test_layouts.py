"""Layouts of viewers parse, name topics and fields that there are, and the packaged ones are what the table makes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from ruamel.yaml import YAML

from beam_ros import messages
from beam_ros.bags.metadata import parse_qos_profiles
from beam_ros.bags.reading import Bag
from beam_ros.cli.main import main
from beam_ros.interfaces.graph import JOINT_STATE, TOPICS
from beam_ros.messages import BagTypes
from beam_ros.offline.export import export_flat_bag
from beam_ros.rig.rig import Rig
from beam_ros.viewers.layouts import LAYOUTS

ROOT = Path(__file__).resolve().parents[3]
MARKERS = Rig.from_file().markers.names
RVIZ_TAKES = {
    "Marker": "visualization_msgs/msg/Marker",
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "Image": "sensor_msgs/msg/Image",
}
PANELS = {"Plot", "Image", "3D", "RawMessages", "DiagnosticSummary"}


def joint_states(bag: Path) -> dict[str, Any]:
    """Return the first JointState of every topic of a bag, by its absolute name."""
    types, found = BagTypes(), {}
    with Bag(bag) as opened:
        for topic in opened.topics:
            if topic.type_name == JOINT_STATE and opened.count(topic.name):
                raw = next(iter(opened.raw_messages(topic.name.lstrip("/"))))
                found[topic.name] = types.deserialize(raw.data, JOINT_STATE)
    return found


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a running rig and a flat bag hold: real messages by topic."""
    flat = tmp_path_factory.mktemp("flat") / "flat"
    with Bag(ROOT / "bags" / "chirp_6s") as bag:
        export_flat_bag(bag, flat)
    state = messages.hub_state(BagTypes(), messages.HubSample(1, 0.001, 0.002, 0.003))
    return {**joint_states(flat), "/hub/state": state}


@pytest.mark.slow
def test_every_curve_of_plotjuggler_is_a_number_of_a_message(seen: dict[str, Any]) -> None:
    # PlotJuggler names a number of a JointState /topic/joint/field.
    there = {
        f"{topic}/{joint}/{field}"
        for topic, message in seen.items()
        for field in ("position", "velocity", "effort")
        for joint, _ in zip(message.name, getattr(message, field), strict=False)
    }
    root = ElementTree.fromstring(LAYOUTS["plotjuggler.xml"](MARKERS, ""))
    names = [curve.attrib["name"] for curve in root.iter("curve")]
    assert len(names) == len(MARKERS) + 3 + len(MARKERS) + 2
    assert set(names) <= there
    for splitter in root.iter("DockSplitter"):
        assert len(splitter) == int(splitter.attrib["count"]) == len(splitter.attrib["sizes"].split(";"))
    for tab in root.iter("Tab"):
        assert int(tab.attrib["containers"]) == len(tab.findall("Container"))


def test_every_path_of_foxglove_leads_to_a_number(seen: dict[str, Any]) -> None:
    layout = json.loads(LAYOUTS["foxglove.json"](MARKERS, ""))
    panels = layout["configById"]
    assert {name.partition("!")[0] for name in panels} == PANELS
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    paths = [path for panel in panels.values() for path in panel.get("paths", ())]
    assert len(paths) == len(MARKERS) + 3
    for path in paths:
        match = re.fullmatch(r"(/[\w/]+)\.(\w+)\[(\d+)\]", path["value"])
        assert match is not None
        topic, field, index = match.groups()
        assert isinstance(float(getattr(seen[topic], field)[int(index)]), float)
        assert seen[topic].name[int(index)] == path["label"]
        # A path that is not enabled draws nothing.
        assert path["enabled"] is True
    topics = {name.lstrip("/") for panel in panels.values() for name in panel.get("topics", ())}
    topics |= {p["imageMode"]["imageTopic"].lstrip("/") for p in panels.values() if "imageMode" in p}
    assert topics == {"beam/shape", "beam/markers", "tracker/debug_image"} <= set(TOPICS)
    assert panels["RawMessages!mode"]["topicPath"] == "/hub/mode.data"
    assert panels["DiagnosticSummary!health"]["topicToRender"] in TOPICS


def leaves(layout: Any) -> Iterator[str]:
    """Yield the panels of a layout, each of whose branches has two parts and a share in percent."""
    if isinstance(layout, str):
        yield layout
        return
    assert set(layout) == {"direction", "first", "second", "splitPercentage"}
    assert layout["direction"] in ("row", "column")
    assert 0 < layout["splitPercentage"] < 100
    yield from leaves(layout["first"])
    yield from leaves(layout["second"])


def test_rviz_shows_topics_of_the_type_that_each_display_takes() -> None:
    content = YAML(typ="safe").load(LAYOUTS["rig.rviz"](MARKERS, ""))["Visualization Manager"]
    assert content["Global Options"]["Fixed Frame"] == "rig"
    shown = [display for display in content["Displays"] if "Topic" in display]
    assert len(shown) == 3
    for display in shown:
        topic = TOPICS[display["Topic"]["Value"].lstrip("/")]
        assert topic.type_name == RVIZ_TAKES[display["Class"].removeprefix("rviz_default_plugins/")]
        assert display["Topic"]["Depth"] == topic.qos.depth


def test_qualities_of_service_are_those_of_the_table() -> None:
    content = YAML(typ="safe").load(LAYOUTS["qos_overrides.yaml"](MARKERS, "rig1"))
    assert set(content) == {
        name if name.startswith("/") else f"/rig1/{name}"
        for name, row in TOPICS.items()
        if not row.is_derived
    }
    for name, profile in content.items():
        row = TOPICS.get(name) or TOPICS[name.removeprefix("/rig1/")]
        assert set(profile) == {"history", "depth", "reliability", "durability"}
        assert parse_qos_profiles([profile]) == (row.qos,)


@pytest.mark.parametrize("name", list(LAYOUTS))
def test_the_packaged_file_is_what_the_table_makes(name: str) -> None:
    packaged = ROOT / "beam_ros" / "config" / "viewers" / name
    assert packaged.read_text(encoding="utf-8") == LAYOUTS[name](MARKERS, ""), (
        "make it anew: rm -r beam_ros/config/viewers && beam export --viewers beam_ros/config/viewers"
    )


def test_one_command_writes_them_for_other_markers_and_a_namespace(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = ["-p", "markers.names:=[low, high]", "-p", "markers.heights:=[0.01, 0.28]"]
    other += ["-p", "markers.masses:=[0.0, 0.0]", "-p", "markers.height_uncertainties:=[0.0005, 0.0005]"]
    command = ["export", "--viewers", str(tmp_path / "viewers"), "--namespace", "rig1", *other]
    assert main(command) == 0
    assert len(capsys.readouterr().out.split()) == len(LAYOUTS)
    assert "/rig1/beam/displacement/high/position" in (tmp_path / "viewers" / "plotjuggler.xml").read_text()
    assert "/rig1/beam/displacement.position[1]" in (tmp_path / "viewers" / "foxglove.json").read_text()
    assert main(command) == 2
    assert "exists and is not an empty folder" in capsys.readouterr().err
    assert main(["export", "--csv", str(tmp_path / "csv")]) == 2
    assert "--viewers takes no bag" in capsys.readouterr().err
