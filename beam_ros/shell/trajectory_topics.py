"""The plain topics of a JointTrajectoryController, for the axis link that drives the hub by them."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from rclpy.task import Future

from beam_ros.bags.batches import encode_trajectory
from beam_ros.hub.contract import HostTime
from beam_ros.hub.gate.beam_guard import BeamGuard
from beam_ros.hub.links.settings_check import SettingsCheck
from beam_ros.hub.links.trajectory import Knots, TrajectoryHub
from beam_ros.interfaces.graph import JOINT_STATE, JOINT_TRAJECTORY, QualityOfService
from beam_ros.messages import RosTypes
from beam_ros.messages.stamps import stamp_ns
from beam_ros.rig.rig import Rig
from beam_ros.shell.node import qos_profile

CONTROLLER_QOS: QoSProfile = qos_profile(QualityOfService(1000))
"""What ros2_control's topics offer and ask for: reliable, volatile."""


_LOOK_S = 0.1


class OwnThread:
    """A node of its own beside the process's first, whose callbacks run in a thread of their own.

    Nothing that keeps the first node's executor busy delays them.

    Parameters
    ----------
    name : str -- of the node and the thread
    context : Context, optional -- that of the first node; None: the process's default
    """

    def __init__(self, name: str, context: Context | None = None) -> None:
        self.node = Node(name, context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name=name, daemon=True)

    def start(self) -> None:
        """Let callbacks run."""
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown(timeout_sec=1.0)
        self._thread.join(timeout=2.0)
        self.node.destroy_node()

    def _spin(self) -> None:
        try:
            while self.node.context.ok() and self._executor.get_nodes():
                self._executor.spin_once(timeout_sec=0.1)
        except (ExternalShutdownException, ShutdownException):
            return


class _Settings:
    """Asks a controller for its settings by its service.

    Parameters
    ----------
    hub : TrajectoryHub -- takes the verdict
    node : Node -- asks
    controller, joint, mode : str -- names of the controller's node and of its joint, and the hub's command mode
    """

    def __init__(self, hub: TrajectoryHub, node: Node, controller: str, joint: str, mode: str) -> None:
        self._controller = controller
        self._logger = node.get_logger()
        self._client = node.create_client(GetParameters, f"{controller}/get_parameters")
        self._check = SettingsCheck(hub, self._ask, self._warn, joint, mode)
        node.create_timer(_LOOK_S, self._look)

    def _look(self) -> None:
        self._check.look(time.monotonic(), is_there=self._client.service_is_ready())

    def _ask(self, name: str) -> None:
        def take(answer: Future) -> None:
            values = [parameter_value_to_python(value) for value in answer.result().values]
            self._check.answer(name, values[0] if values else None)

        self._client.call_async(GetParameters.Request(names=[name])).add_done_callback(take)

    def _warn(self) -> None:
        self._logger.warning(
            f"the parameters of {self._controller} cannot be read yet: expected its service get_parameters; until "
            "it is there, see to it yourself that interpolation_method is splines, and allow_partial_joints_goal "
            "true where it leads more joints than one",
            once=True,
        )


class TrajectoryLink(TrajectoryHub):
    """A hub behind a JointTrajectoryController on this graph; implements ``Hub``.

    Parameters
    ----------
    rig : Rig -- names of controller, topic and joint, and the axis
    guard : callable -- the check of whole sequences
    """

    def __init__(self, rig: Rig, guard: BeamGuard) -> None:
        settings = rig.trajectory
        types = RosTypes()
        self._joint = settings.joint
        self._own = OwnThread("hub_link")
        self._trajectories = self._own.node.create_publisher(
            types.message_class(JOINT_TRAJECTORY), f"{settings.controller}/joint_trajectory", CONTROLLER_QOS
        )
        super().__init__(rig.axis_parameters(), rig.trajectory_parameters(), self._publish, guard)
        _Settings(self, self._own.node, settings.controller, settings.joint, rig.hub.command_mode)
        self._own.node.create_subscription(
            types.message_class(JOINT_STATE), settings.joint_states, self._on_joint_state, CONTROLLER_QOS
        )
        self._own.start()

    def close(self) -> None:
        """Stop the axis and leave the graph."""
        super().close()
        self._own.close()

    def _publish(self, knots: Knots) -> None:
        columns = {"positions": knots.positions}
        if knots.velocities is not None:
            columns["velocities"] = knots.velocities
        message = encode_trajectory(self._joint, knots.start_ns, knots.times_ns, columns)
        try:
            self._trajectories.publish(message)
        except RuntimeError:
            if rclpy.ok():
                raise
            # The process ends, and ROS is gone: set-points stop by themselves, a sequence runs to its end.

    def _on_joint_state(self, message: Any) -> None:
        if self._joint not in message.name:
            self.no_state(
                f"the joint states are of {', '.join(message.name) or 'no joint'}: expected {self._joint!r} among "
                "them; correct trajectory.joint or trajectory.joint_states"
            )
            return
        k = list(message.name).index(self._joint)

        def value(column: Any) -> float | None:
            number = float(column[k]) if k < len(column) else math.nan
            return number if math.isfinite(number) else None

        position = value(message.position)
        if position is None:
            self.no_state(
                f"the joint states give {self._joint!r} no finite position: expected one; look at its state "
                "interfaces"
            )
            return
        now = HostTime(time.monotonic_ns(), time.time_ns())
        self.joint_state(stamp_ns(message), position, value(message.velocity), value(message.effort), now)
