"""What every node of the rig shares: its start and end, its parameters, its topics and its diagnostics.

A node file adds wiring and callbacks of a few lines to ``RigNode`` and hands its class to ``run_node``.
Parameters, topics and services come from the tables of ``beam_ros.interfaces``, so that no node can spell them
differently, and a node declares the parameters that it reads and no others.
"""

from __future__ import annotations

import contextlib
import inspect
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle, ParameterNotDeclaredException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args

from beam_ros import messages
from beam_ros.errors import ParameterFileError, RigError, UsageError, faults_of_the_user, suggestion
from beam_ros.interfaces import graph
from beam_ros.interfaces.parameter import Parameter
from beam_ros.interfaces.parameter_files import parameter_sections
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.messages import RosTypes
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import NO_CLOCK, check_time

FAULT_OF_THE_USER = 2
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_MAX_CALLBACK_S = 1.0
"""A callback that goes on for so long after a signal is ended by what rclpy raises when the graph is gone [s]."""
_LAST_WORD = Duration(seconds=0.5)
"""So long a node that ends waits for its readers to have its last word: a few repetitions of what was lost."""
_FIRST_LOOK_S = 0.5
"""So long a node that follows /clock waits for it before it warns [s]; the time to find each other on the graph."""
_REQUEST_SENT_NS: ContextVar[int] = ContextVar("_REQUEST_SENT_NS")
"""Steady time [ns] at which a request was sent, by the clock of who sent it."""
_GRAPH_IS_GONE = ("RCLError", "InvalidHandle", "NotInitializedException")
"""What rclpy raises in a callback when a signal shuts the graph down between two of its lines."""

_OVERRIDDEN = ("_guard", "_take_service")
"""What rclpy keeps to itself, and the executor below replaces; another rclpy may not have it."""


def request_sent_ns() -> int:
    """Return the steady time [ns] at which the request was sent that a callback begins to answer.

    Where the executor does not hand it on (another rclpy, or a process that composes nodes by itself) that is now.
    """
    return _REQUEST_SENT_NS.get(time.monotonic_ns())


def make_executor() -> SingleThreadedExecutor:
    """Make an executor that hands on when a request was sent, and does not wake itself.

    rclpy receives the time beside a request and keeps it to itself. And it wakes its own executor twice for every
    callback, for the sake of executors with several threads: each time all that can be waited for is put together
    anew. Here the only thread, which is the one that makes the executor, comes round by itself. An rclpy that is
    made otherwise keeps its executor as it is: the nodes then take more time, and a request counts as sent when it
    is taken.
    """
    executor = SingleThreadedExecutor()
    if all(hasattr(executor, name) for name in _OVERRIDDEN):
        wake, own_thread = executor._guard.trigger, threading.get_ident()
        executor._guard.trigger = lambda: None if threading.get_ident() == own_thread else wake()
        executor._take_service = _take_service
    return executor


def _take_service(srv: Service) -> Callable[[], Coroutine[Any, Any, None]] | None:
    """Do as rclpy's executor does, and note when the request was sent."""
    try:
        with srv.handle:
            request, header = srv.handle.service_take_request(srv.srv_type.Request)
    except InvalidHandle:
        return None  # The service was taken away meanwhile.

    async def answer() -> None:
        if header is not None:
            _REQUEST_SENT_NS.set(time.monotonic_ns() - (time.time_ns() - header.source_timestamp))
            answered = srv.callback(request, srv.srv_type.Response())
            srv.send_response(await answered if inspect.isawaitable(answered) else answered, header)

    return answer


def qos_profile(qos: graph.QualityOfService) -> QoSProfile:
    """Turn a row of the table into rclpy's profile."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.is_latched else DurabilityPolicy.VOLATILE,
    )


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        name=parameter.name,
        description=parameter.meaning(),
        additional_constraints=parameter.expectation(),
        read_only=not parameter.is_live,
    )
    if parameter.minimum is not None and parameter.maximum is not None:
        if parameter.kind is float:
            limits = FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)
            descriptor.floating_point_range = [limits]
        elif parameter.kind is int:
            limits = IntegerRange(from_value=int(parameter.minimum), to_value=int(parameter.maximum))
            descriptor.integer_range = [limits]
    return descriptor


class RigNode(Node):  # type: ignore[misc]
    """A node of the rig with its checked parameters, its topics from the table and its diagnostics.

    Parameters
    ----------
    executable : str -- key of ``beam_ros.interfaces.graph.NODES``
    **options -- keyword arguments of ``rclpy.node.Node``: context, namespace, parameter_overrides, cli_args, ...

    Attributes
    ----------
    rig : Rig -- the parameters in force, checked; those of other nodes as this node's file gives them
    types : RosTypes -- rclpy's message classes, as the message builders want them
    health_timer : Timer -- publishes the diagnostics

    Raises
    ------
    ParameterFileError
        A parameter given to the node is unknown or has a wrong type, word or range.
    UsageError
        The node cannot keep the time that it is given.
    """

    def __init__(self, executable: str, **options: Any) -> None:
        self.row = graph.NODES[executable]
        super().__init__(self.row.name, automatically_declare_parameters_from_overrides=True, **options)
        self.types = RosTypes()
        self.rig = self._declare_parameters()
        check_time(executable, self.rig, uses_sim_time=self._uses_sim_time())
        self.add_pre_set_parameters_callback(self._in_their_types)
        self.add_on_set_parameters_callback(self._check_new_values)
        self._diagnostics = self.offer("/diagnostics")
        # On the steady clock, so that a node is heard also while the time that it follows stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.health_timer = self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        if self._uses_sim_time():
            self._first_look = self.create_timer(_FIRST_LOOK_S, self._look_for_clock, clock=steady)

    def _declare_parameters(self) -> Rig:
        given = {
            name: parameter.value
            for name, parameter in self.get_parameters_by_prefix("").items()
            if name not in ("use_sim_time", "start_type_description_service")
            and not name.startswith("qos_overrides.")
        }
        rig = Rig.from_file().with_values({name: _plain(value) for name, value in given.items()})
        for name in given:
            self.undeclare_parameter(name)
        for name in self.row.parameters:
            self.declare_parameter(name, rig[name], _descriptor(RIG_PARAMETERS[name]), ignore_override=True)
        return rig

    def _in_their_types(self, parameters: list[RosParameter]) -> list[RosParameter]:
        """Return new values in their parameters' types; what cannot be one is refused in the next steps."""
        taken = []
        for parameter in parameters:
            name = parameter.name
            if not self.has_parameter(name):
                raise ParameterNotDeclaredException(f"{name} ({suggestion(name, self.row.parameters)})")
            if name in RIG_PARAMETERS:
                with contextlib.suppress(ParameterFileError):
                    value = RIG_PARAMETERS[name].check(_plain(parameter.value))
                    parameter = RosParameter(name, value=value)
            taken.append(parameter)
        return taken

    def _check_new_values(self, parameters: list[RosParameter]) -> SetParametersResult:
        try:
            new = {p.name: _plain(p.value) for p in parameters if p.name in RIG_PARAMETERS}
            rig = self.rig.with_values(new)
            asked = [p.value for p in parameters if p.name == "use_sim_time"]
            check_time(self.row.executable, rig, uses_sim_time=any(asked) if asked else self._uses_sim_time())
            self.rig = rig
        except (ParameterFileError, UsageError) as err:
            return SetParametersResult(successful=False, reason=str(err))
        return SetParametersResult(successful=True)

    def offer(self, topic: str) -> Publisher:
        """Create the publisher of a topic of the table that this node may publish."""
        _require(topic, self.row.publishes, f"{self.row.executable} publishes")
        row = graph.TOPICS[topic]
        return self.create_publisher(self.types.message_class(row.type_name), topic, qos_profile(row.qos))

    def listen(
        self,
        topic: str,
        callback: Callable[..., None],
        qos: graph.QualityOfService | None = None,
        **options: Any,
    ) -> Subscription:
        """Create the subscription of a topic of the table; ``raw=True`` hands over the wire's bytes.

        Parameters
        ----------
        topic : str -- name in the table
        callback : callable -- takes a message
        qos : QualityOfService, optional -- by default the table's
        **options -- for rclpy
        """
        _require(topic, self.row.subscribes, f"{self.row.executable} subscribes to")
        row = graph.TOPICS[topic]
        return self.create_subscription(
            self.types.message_class(row.type_name), topic, callback, qos_profile(qos or row.qos), **options
        )

    def serve(self, service: str, callback: Callable[..., Any], **options: Any) -> Service:
        """Create a service of the table that this node may serve."""
        _require(service, self.row.serves, f"{self.row.executable} serves")
        row = graph.SERVICES[service]
        return self.create_service(self.types.service_class(row.type_name), service, callback, **options)

    def call_of(self, service: str, **options: Any) -> Client:
        """Create the client of a service of the table that this node may call."""
        _require(service, self.row.calls, f"{self.row.executable} calls")
        row = graph.SERVICES[service]
        return self.create_client(self.types.service_class(row.type_name), service, **options)

    def now_ns(self) -> int:
        """Now by the node's clock [ns, UNIX unless simulated time is in use]."""
        return int(self.get_clock().now().nanoseconds)

    def health(self) -> tuple[str, str, Mapping[str, object]]:
        """Report this node's health: level (OK, WARN or ERROR), a sentence, and counters."""
        return "OK", "running", {}

    def close(self) -> None:
        """Release what the node holds; called once, also after a failure.

        The graph is there still, unless its context was shut down: a latched topic that says what the node does is to
        say now that it ends.
        """

    def say_last(self, publisher: Publisher, message: Any) -> None:
        """Publish the last message of a latched topic, and wait until its readers have it."""
        if self.context.ok():
            publisher.publish(message)
            publisher.wait_for_all_acked(_LAST_WORD)

    def _uses_sim_time(self) -> bool:
        return bool(self.get_parameter("use_sim_time").value)

    def _lacks_clock(self) -> bool:
        """Say whether the time that this node follows does not come, and warn of it."""
        if not self._uses_sim_time() or self.now_ns():
            return False
        self.get_logger().warning(NO_CLOCK, throttle_duration_sec=10.0)
        return True

    def _look_for_clock(self) -> None:
        self._first_look.cancel()
        self._lacks_clock()

    def _publish_diagnostics(self) -> None:
        level, sentence, counters = self.health()
        if self._lacks_clock():
            level, sentence = "ERROR", NO_CLOCK
        name = f"{self.get_fully_qualified_name().lstrip('/')}: {self.row.executable}"
        status = messages.Health(name, level, sentence, self.row.name, counters)
        self._diagnostics.publish(messages.diagnostics(self.types, self.now_ns(), [status]))


def _require(name: str, names: tuple[str, ...], who: str) -> None:
    if name not in names:
        raise ValueError(f"{who} {names}, not {name}: add it to the node's row in interfaces.graph")


def _plain(value: Any) -> object:
    """Turn rclpy's array types into lists, which the table knows."""
    return list(value) if hasattr(value, "tolist") or isinstance(value, tuple) else value


class _Ending:
    """Takes SIGINT and SIGTERM, and ends the spin while there still is a graph to say so on.

    rclpy's own handlers shut the graph down first, so that no node could say its last word. Python's own handlers run
    between any two lines of the main thread, also where it holds a lock. So a second thread does what is to be done:
    it wakes the executor and, where a callback goes on and on, shuts the graph down after all.
    """

    def __init__(self) -> None:
        self.is_asked = False
        # A node that is being made has nothing to say yet, and may wait for something on the graph.
        self._interrupt: Callable[[], None] = rclpy.try_shutdown
        self._has_left = threading.Event()
        self._heard, self._told = socket.socketpair()
        self._told.setblocking(False)
        for number in _SIGNALS:
            # In place of Python's, which raises in the main thread.
            signal.signal(number, lambda _number, _frame: None)
        signal.set_wakeup_fd(self._told.fileno())
        threading.Thread(target=self._wait, name="ending", daemon=True).start()

    def spin(self, executor: SingleThreadedExecutor) -> None:
        """Run callbacks until a signal comes or the context is shut down."""
        self._interrupt = executor.wake
        while not self.is_asked and rclpy.ok():
            executor.spin_once()

    def close(self) -> None:
        """Ignore the signals from now on."""
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        signal.set_wakeup_fd(-1)
        self._interrupt = lambda: None
        self._has_left.set()
        self._told.close()

    def _wait(self) -> None:
        with self._heard:
            while self._heard.recv(1):
                self.is_asked = True
                self._interrupt()
                if not self._has_left.wait(_MAX_CALLBACK_S):
                    rclpy.try_shutdown()


def run_node(build: Callable[[], RigNode], argv: list[str] | None = None) -> int:
    """Run a node until SIGINT, SIGTERM or a shutdown of its context, and end it cleanly.

    The node ends with status 0 on a signal, also when it comes twice, and with 2 and one line on a fault of
    the user's. It is closed before it leaves the graph.

    Parameters
    ----------
    build : callable -- makes the node, after rclpy is initialised
    argv : list of str, optional -- arguments with ``--ros-args``; by default the process's own

    Returns
    -------
    int -- exit status
    """
    ending = _Ending()
    arguments = sys.argv if argv is None else ["node", *argv]
    status = 0
    node: RigNode | None = None
    executor: SingleThreadedExecutor | None = None
    try:
        _initialise(arguments)
        if not ending.is_asked:
            node = build()
            executor = make_executor()
            executor.add_node(node)
            ending.spin(executor)
    except ExternalShutdownException:
        pass
    except Exception as err:
        if isinstance(err, faults_of_the_user()):
            print(f"{build.__module__.rpartition('.')[2]}: {err}", file=sys.stderr)  # noqa: T201
            status = FAULT_OF_THE_USER
        elif rclpy.ok() or type(err).__name__ not in _GRAPH_IS_GONE:
            raise
    finally:
        ending.close()
        if node is not None:
            node.close()
        if executor is not None:
            executor.shutdown(timeout_sec=0.0)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return status


def _initialise(arguments: list[str]) -> None:
    files = [arguments[i + 1] for i, word in enumerate(arguments[:-1]) if word == "--params-file"]
    for path in files:
        parameter_sections(Path(path))
    try:
        surplus = remove_ros_args(arguments)[1:]
        if not surplus:
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as err:
        raise RigError(
            f"ROS refuses the arguments {' '.join(arguments[1:])}: {err}; expected "
            "--ros-args [-p name:=value] [--params-file FILE] [-r from:=to]"
        ) from err
    if surplus:
        raise UsageError(
            f"unknown arguments {' '.join(surplus)}: expected --ros-args [-p name:=value] [--params-file FILE] "
            "[-r from:=to]"
        )
