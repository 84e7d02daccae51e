"""Paths into messages, without a bag."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.errors import UsageError
from beam_ros.signals.field_paths import FieldPath, numeric_fields
from tests.beam_ros.signals.foreign_bags import START, STORE, TYPES, header


def test_the_header_that_is_nearest_to_the_number_says_when() -> None:
    vector = TYPES["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
    turn = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    moves = [
        TYPES["geometry_msgs/msg/TransformStamped"](
            header(START + k), frame, TYPES["geometry_msgs/msg/Transform"](vector, turn)
        )
        for k, frame in enumerate(("hub", "tip.left"))
    ]
    message = TYPES["tf2_msgs/msg/TFMessage"](moves)
    found = FieldPath.of("transforms[tip.left].transform.translation.y").read(message)
    assert found == (2.0, START + 1)
    missing = FieldPath.of("transforms[tip].transform.translation.y").read(message)
    assert np.isnan(missing.value)


def test_a_message_without_header_has_no_stamp() -> None:
    message = TYPES["std_msgs/msg/Float64"](2.5)
    assert FieldPath.of("data").read(message) == (2.5, None)


@pytest.mark.parametrize("text", ["", "a..b", "a[", "a[1", "1a", "a b"])
def test_what_is_no_path_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="no path to a field"):
        FieldPath.of(text)


def test_all_numbers_of_a_type_are_listed() -> None:
    known = numeric_fields("sensor_msgs/msg/Imu", lambda name: STORE.fielddefs[name][1])
    assert "linear_acceleration.x" in known
    assert "angular_velocity_covariance[]" in known
    assert not [name for name in known if "header" in name]
