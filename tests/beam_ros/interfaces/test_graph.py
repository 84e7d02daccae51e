"""The table of the graph is whole in itself."""

from __future__ import annotations

import pytest

from beam_ros.interfaces import graph
from beam_ros.interfaces.graph import NODES, SERVICES, TOPICS, RigKind
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.messages import BagTypes
from beam_ros.process.executables import MODULES


def test_nodes_name_only_topics_and_services_of_the_table() -> None:
    for node in NODES.values():
        assert set(node.publishes) | set(node.subscribes) <= set(TOPICS)
        assert set(node.serves) | set(node.calls) <= set(SERVICES)
        assert len(set(node.parameters)) == len(node.parameters)
        assert set(node.parameters) <= set(RIG_PARAMETERS)


def test_every_parameter_is_read_by_a_node_or_by_what_works_on_bags() -> None:
    declared = {name for node in NODES.values() for name in node.parameters}
    assert set(RIG_PARAMETERS) - declared == {
        "hub.applied_hold",
        "hub.measured_hold",
        "markers.height_uncertainties",
    }


def test_every_topic_has_a_publisher_or_is_a_command_and_every_service_a_server() -> None:
    published = {name for node in NODES.values() if node.name != "player" for name in node.publishes}
    assert set(TOPICS) - published == {"hub/setpoint"}
    assert {name for node in NODES.values() for name in node.serves} == set(SERVICES)


def test_simulator_and_driver_are_the_same_node_to_everybody_else() -> None:
    simulator, driver = NODES["simulator"], NODES["hub_driver"]
    of_the_hub = {name for name in simulator.publishes if name.startswith("hub/")} | {"/diagnostics"}
    assert simulator.name == driver.name == "hub"
    assert set(driver.publishes) == of_the_hub
    assert (simulator.subscribes, simulator.serves) == (driver.subscribes, driver.serves)
    of_the_hub = {name for name in RIG_PARAMETERS if name.startswith(("hub.", "beam."))}
    assert of_the_hub & set(simulator.parameters) == of_the_hub & set(driver.parameters) != set()


def test_every_node_is_an_executable() -> None:
    assert set(NODES) == set(MODULES) - {"beam"}


def test_every_topic_has_a_type_of_ros_jazzy() -> None:
    types = BagTypes().store.types
    assert all(topic.type_name in types for topic in TOPICS.values())


def test_commands_are_marked_so_that_no_replay_moves_an_axis() -> None:
    assert {name for name, topic in TOPICS.items() if topic.is_command} == {"hub/setpoint", "hub/sequence"}


@pytest.mark.parametrize("rig", list(RigKind))
def test_every_rig_has_exactly_one_hub(rig: RigKind) -> None:
    nodes = graph.nodes_of_rig(rig)
    assert [NODES[name].name for name in nodes].count("hub") == 1
