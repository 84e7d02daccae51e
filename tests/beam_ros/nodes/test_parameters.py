"""Parameters of the nodes: the same schema as the files, refused in one line where they are wrong."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("-p", "beam.lenght:=0.3"), "did you mean beam.length"),
        (("-p", "beam.length:=300"), "0.01 to 5 m"),
        (("--params-file", "nowhere.yaml"), "no such file"),
        (("--params-file", "broken.yaml"), "broken.yaml"),
    ],
)
def test_a_wrong_parameter_ends_the_node_with_one_line(executables, tmp_path, words, expected) -> None:
    (tmp_path / "broken.yaml").write_text("/**: {ros__parameters: {beam: [")
    node = executables.run("simulator", "--ros-args", *words, timeout_s=20.0)
    assert node.process.returncode == 2
    assert len(node.output().strip().splitlines()) == 1, node.output()
    assert expected in node.output()


def test_a_missing_serial_port_is_one_line_and_status_2(executables) -> None:
    node = executables.run("hub_driver", "--ros-args", "-p", "serial.port:=/dev/ttyNOWHERE0", timeout_s=20.0)
    assert node.process.returncode == 2
    assert len(node.output().strip().splitlines()) == 1, node.output()
    assert "/dev/ttyNOWHERE0" in node.output()


def test_parameters_carry_descriptions_and_refuse_what_the_schema_refuses(executables, graph) -> None:
    from rcl_interfaces.srv import DescribeParameters, SetParameters
    from rclpy.parameter import Parameter

    executables.start("excitation_generator", "--ros-args", "-p", "camera.rate:=50")
    describe = graph.node.create_client(DescribeParameters, "/excitation/describe_parameters")
    change = graph.node.create_client(SetParameters, "/excitation/set_parameters")
    graph.wait(lambda: describe.service_is_ready() and change.service_is_ready(), "parameter services", 20.0)

    def ask(client, request):
        future = client.call_async(request)
        graph.wait(future.done, "an answer")
        return future.result()

    names = ["beam.length", "excitation.duration"]
    length, duration = ask(describe, DescribeParameters.Request(names=names)).descriptors
    assert "[m]" in length.description
    assert length.read_only
    assert not duration.read_only
    assert (length.floating_point_range[0].from_value, length.floating_point_range[0].to_value) == (0.01, 5.0)

    def set_value(name, value):
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return ask(change, request).results[0]

    assert set_value("excitation.duration", 5).successful  # a whole number passes for a number
    refused = set_value("excitation.start_frequency", 500.0)
    assert not refused.successful
    assert "start below the end" in refused.reason
    assert not set_value("beam.length", 0.2).successful


@pytest.mark.parametrize("name", ["nowhere.avi", "words.avi"])
def test_a_video_that_is_none_is_one_line_and_status_2(executables, tmp_path, name) -> None:
    (tmp_path / "words.avi").write_text("words")
    path = tmp_path / name
    words = ("-p", "tracker.source:=file", "-p", f"tracker.video:={path}")
    node = executables.run("vision_tracker", "--ros-args", *words, timeout_s=20.0)
    assert node.process.returncode == 2
    assert sum("vision_tracker:" in line for line in node.output().splitlines()) == 1, node.output()
    assert str(path) in node.output()
    assert "Traceback" not in node.output()
