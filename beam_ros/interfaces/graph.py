"""The rig's graph as one table: nodes, topics, services, types, qualities of service, and who reads what.

Everything that names a topic reads it here: the nodes, the recorder, the bag writer, ``beam up``, the launch
file, the viewers' layouts and the tests. Names are relative, so that a namespace moves the whole rig. The
table is data; nothing here needs ROS.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum

from beam_ros.interfaces.rig_parameters import GROUPS

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
STRING = "std_msgs/msg/String"
TRIGGER = "std_srvs/srv/Trigger"
SET_BOOL = "std_srvs/srv/SetBool"

HUB_JOINT = "hub"
"""Name of the hub's one joint in every JointState and JointTrajectory."""

RIG_FRAME = "rig"
CAMERA_FRAME = "camera_optical_frame"


class RigKind(str, Enum):
    """What stands behind the node ``hub`` and the camera's topics."""

    SIMULATED = "simulated"
    EMULATED = "emulated"
    REAL = "real"


@dataclass(frozen=True)
class QualityOfService:
    """The four policies of a topic that the suite sets; all else is ROS 2's default.

    Attributes
    ----------
    depth : int -- messages kept on either side (KEEP_LAST)
    is_reliable : bool -- RELIABLE, else BEST_EFFORT
    is_latched : bool -- TRANSIENT_LOCAL: a late subscriber receives the last messages
    """

    depth: int
    is_reliable: bool = True
    is_latched: bool = False


@dataclass(frozen=True)
class Topic:
    """A topic of the rig.

    Attributes
    ----------
    name : str -- relative name; absolute only for ``/diagnostics`` and ``/clock``
    type_name : str -- message type, "package/msg/Name"
    qos : QualityOfService -- as offered by its publishers
    meaning : str -- one line with units
    is_command : bool -- moves an axis when somebody publishes on it; never replayed unasked
    is_image : bool -- large; recorded on request only
    is_derived : bool -- holds nothing but what others hold, to look at or to send far; never recorded
    is_needed : bool -- no identification without it: a recorder that hears nothing of it says so
    """

    name: str
    type_name: str
    qos: QualityOfService
    meaning: str
    is_command: bool = False
    is_image: bool = False
    is_derived: bool = False
    is_needed: bool = False


@dataclass(frozen=True)
class Service:
    """A service of the rig: relative name, type "package/srv/Name", one line of meaning."""

    name: str
    type_name: str
    meaning: str


@dataclass(frozen=True)
class Node:
    """A node of the rig.

    Attributes
    ----------
    executable : str -- what ``ros2 run beam_ros ...`` and ``beam run ...`` start
    name : str -- name on the graph; the simulator and the driver are both ``hub``
    publishes, subscribes : tuple of str -- names in TOPICS; some only at certain values of the parameters
    serves, calls : tuple of str -- names in SERVICES
    parameters : tuple of str -- names in RIG_PARAMETERS: those that the node reads, which it declares
    meaning : str -- one line
    """

    executable: str
    name: str
    publishes: tuple[str, ...]
    subscribes: tuple[str, ...]
    serves: tuple[str, ...]
    parameters: tuple[str, ...]
    meaning: str
    calls: tuple[str, ...] = ()


_DATA = QualityOfService(depth=1000)
_LATCHED = QualityOfService(depth=1, is_latched=True)

TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        Topic(
            "hub/setpoint",
            JOINT_TRAJECTORY,
            QualityOfService(1),
            "one stamped set-point for the hub; refused when older than 0.2 s",
            is_command=True,
        ),
        Topic(
            "hub/sequence",
            JOINT_TRAJECTORY,
            _DATA,
            "a sequence in chunks of at most 500 points that share one start stamp",
            is_command=True,
        ),
        Topic("hub/sequence_state", STRING, _LATCHED, "JSON: id, state, points received, reason, late"),
        Topic(
            "hub/applied",
            JOINT_TRAJECTORY,
            _DATA,
            "batches of the reference really applied, a point per device tick [m, m/s, m/s^2 or N by command "
            "mode]",
        ),
        Topic(
            "hub/measured",
            JOINT_TRAJECTORY,
            _DATA,
            "batches of what the device measured: positions [m], velocities [m/s], effort [N]",
            is_needed=True,
        ),
        Topic(
            "hub/state",
            JOINT_STATE,
            QualityOfService(100),
            "newest hub sample, for people and viewers [m, m/s, N]",
        ),
        Topic(
            "hub/mode",
            "std_msgs/msg/String",
            _LATCHED,
            "JSON at every change: state, activity, fault (number, name, sentence, remedy), since, reason",
        ),
        Topic(
            "hub/clock_sync",
            "sensor_msgs/msg/TimeReference",
            QualityOfService(100),
            "host stamp against device time, with epoch and round trip",
        ),
        Topic(
            "camera/image_raw", "sensor_msgs/msg/Image", QualityOfService(5), "camera frames", is_image=True
        ),
        Topic(
            "camera/image_raw/compressed",
            "sensor_msgs/msg/CompressedImage",
            QualityOfService(5),
            "the same frames as JPEG or PNG, for a network; the simulated ones only while somebody listens",
            is_image=True,
            is_derived=True,
        ),
        Topic(
            "camera/camera_info",
            "sensor_msgs/msg/CameraInfo",
            QualityOfService(5),
            "size and optics of the frames",
        ),
        Topic(
            "beam/displacement",
            JOINT_STATE,
            _DATA,
            "absolute displacement u of every marker [m]; NaN where a marker was not seen",
            is_needed=True,
        ),
        Topic(
            "beam/markers",
            "sensor_msgs/msg/PointCloud2",
            QualityOfService(100),
            "every marker in the frame: x, y, z [m], u, v [px], x_m, sigma_m [m], id, valid",
        ),
        Topic(
            "beam/shape",
            "visualization_msgs/msg/Marker",
            QualityOfService(1),
            "the deflected beam as a line, as far as the markers tell [m]; only while somebody listens",
            is_derived=True,
        ),
        Topic(
            "tracker/debug_image",
            "sensor_msgs/msg/Image",
            QualityOfService(1),
            "the camera's frame with what was measured drawn into it; only while somebody listens",
            is_image=True,
            is_derived=True,
        ),
        Topic(
            "excitation/info",
            STRING,
            _LATCHED,
            "JSON: the signal's recipe, seed, hold and the rig's parameters",
        ),
        Topic("recorder/state", STRING, _LATCHED, "JSON: recording or not, path, messages written"),
        Topic(
            "identification/result", STRING, _LATCHED, "JSON: the identified model and where its report lies"
        ),
        Topic(
            "identification/live",
            STRING,
            _LATCHED,
            "JSON, at most 2 Hz: modes, responses and tests from the samples that have arrived",
            is_derived=True,
        ),
        Topic(
            "/diagnostics",
            DIAGNOSTICS,
            QualityOfService(10),
            "health of every node, 1 Hz",
        ),
        Topic(
            "/clock",
            "rosgraph_msgs/msg/Clock",
            QualityOfService(10),
            "simulated time, only when it does not run in real time",
        ),
    )
}

SERVICES: dict[str, Service] = {
    service.name: service
    for service in (
        Service("hub/enable", SET_BOOL, "switch the axis on or off"),
        Service("hub/home", TRIGGER, "find home; the hub's position is zero there"),
        Service("hub/stop", TRIGGER, "decelerate to rest, unload any sequence, disable"),
        Service("hub/clear_fault", TRIGGER, "leave the fault state; enables nothing"),
        Service("excitation/start", TRIGGER, "hand the sequence over and start it"),
        Service("excitation/stop", TRIGGER, "abort the running sequence"),
        Service(
            "tracker/reset", TRIGGER, "forget the markers and calibration points and acquire the markers anew"
        ),
        Service(
            "tracker/capture_point", TRIGGER, "average the markers against the reference at this position"
        ),
        Service("tracker/fit_calibration", TRIGGER, "fit pixels to metres through the captured points"),
        Service("tracker/tare", TRIGGER, "make the present position the zero of every marker"),
        Service("recorder/start", TRIGGER, "start a recording"),
        Service("recorder/stop", TRIGGER, "close the recording"),
        Service("player/pause", SET_BOOL, "let the replay stand still, or go on"),
        Service("player/step", TRIGGER, "play the next message of a replay that stands still"),
        Service(
            "identifier/identify", TRIGGER, "identify a model from the bag of parameter `identifier.bag`"
        ),
    )
}

_HUB_PUBLISHES = (
    "hub/sequence_state",
    "hub/mode",
    "hub/applied",
    "hub/measured",
    "hub/state",
    "hub/clock_sync",
    "/diagnostics",
)
_HUB_SERVES = ("hub/enable", "hub/home", "hub/stop", "hub/clear_fault")
_CAMERA = ("camera/image_raw", "camera/image_raw/compressed", "camera/camera_info")
_RECORDED = tuple(name for name, topic in TOPICS.items() if not topic.is_derived)


LIVE_NEEDS = (
    "hub/measured",
    "hub/applied",
    "hub/clock_sync",
    "hub/sequence_state",
    "beam/displacement",
    "excitation/info",
)
"""What an identification reads of a bag, and of a rig that runs."""


def _group(group: str, *left_out: str) -> tuple[str, ...]:
    """Return the names of a group's parameters, without some of its fields."""
    return tuple(f"{group}.{field.name}" for field in fields(GROUPS[group]) if field.name not in left_out)


_BEAM = (*_group("beam", "max_root_strain"), "markers.heights", "markers.masses", "hub.mass")
"""What the model of the beam is made from."""

_AXIS = _group("hub", "mass", "max_tip_deflection", "applied_hold", "measured_hold")
"""What the hub can do and how it is commanded."""

_GUARD = ("hub.max_tip_deflection", "beam.max_root_strain")
"""What the hub may do to the beam, besides ``hub.max_effort``."""

_LINKS = tuple(
    name for group in ("axis", "serial", "trajectory", "odrive", "dynamixel", "csv") for name in _group(group)
)
"""How the axis is reached, for every kind of link."""

_CONTROLLER = ("axis.kind", "axis.metres_per_unit", *_group("trajectory", "max_knots"))
"""Whose controller is emulated."""

_FILM = (
    *("markers.names", "markers.diameter", "tracker.polarity"),
    *_group("camera", "driver"),
    *_group("simulation", "images", "real_time_factor", "hub_clock_ppm"),
)
"""What a simulated camera shows of the beam, and how far from ideal hub and camera are."""

NODES: dict[str, Node] = {
    node.executable: node
    for node in (
        Node(
            "simulator",
            "hub",
            (*_HUB_PUBLISHES, *_CAMERA, "beam/displacement", "/clock"),
            ("hub/setpoint", "hub/sequence"),
            _HUB_SERVES,
            (
                *(*_BEAM, *_AXIS, *_GUARD, *_FILM),
                *("simulation.images", "simulation.real_time_factor", "simulation.hub_clock_ppm"),
                *_group("faults"),
            ),
            "the beam on its hub, integrated in real time, and the camera that films it",
        ),
        Node(
            "hub_driver",
            "hub",
            _HUB_PUBLISHES,
            ("hub/setpoint", "hub/sequence"),
            _HUB_SERVES,
            (*_BEAM, *_AXIS, *_GUARD, *_LINKS, "simulation.real_time_factor"),
            "the motion controller behind a serial port or another axis link",
        ),
        Node(
            "firmware_emulator",
            "firmware_emulator",
            (*_CAMERA, "/diagnostics"),
            (),
            (),
            (
                *(*_BEAM, *_AXIS, *_FILM, *_group("emulator"), *_group("faults"), *_CONTROLLER),
                "simulation.real_time_factor",
            ),
            "a motion controller of any kind, with the beam on its hub and a camera that films it",
        ),
        Node(
            "vision_tracker",
            "tracker",
            ("beam/displacement", "beam/markers", "beam/shape", "tracker/debug_image", "/diagnostics"),
            (*_CAMERA, "hub/state"),
            ("tracker/reset", "tracker/capture_point", "tracker/fit_calibration", "tracker/tare"),
            (
                *_BEAM,
                *("markers.names", "markers.diameter", "hub.encoder_resolution", "hub.max_tip_deflection"),
                *_group("camera"),
                *_group("tracker"),
            ),
            "sub-pixel positions of the markers in the camera's frames",
        ),
        Node(
            "excitation_generator",
            "excitation",
            ("hub/sequence", "excitation/info", "/diagnostics"),
            ("hub/sequence_state", "hub/state"),
            ("excitation/start", "excitation/stop"),
            (*_BEAM, *_AXIS, *_GUARD, *_group("excitation")),
            "chirps, multisines and steps for the hub, checked against its limits",
            calls=("hub/stop",),
        ),
        Node(
            "bag_recorder",
            "recorder",
            ("recorder/state", "/diagnostics"),
            _RECORDED,
            ("recorder/start", "recorder/stop"),
            _group("recorder"),
            "every topic but the images into one bag",
        ),
        Node(
            "bag_player",
            "player",
            _RECORDED,
            (),
            ("player/pause", "player/step"),
            _group("player"),
            "a bag back onto its topics; commands left out",
        ),
        Node(
            "identifier",
            "identifier",
            ("identification/result", "/diagnostics"),
            (),
            ("identifier/identify",),
            _group("identifier"),
            "continuous-time model with common poles from a recorded bag",
        ),
        Node(
            "live_identifier",
            "live_identifier",
            ("identification/live", "/diagnostics"),
            LIVE_NEEDS,
            (),
            _group("live"),
            "the same model from what has arrived so far, while the rig runs",
        ),
    )
}


def emulated_port(path: str) -> dict[str, object]:
    """Parameters with which the emulator offers, and the driver expects, a port at a path."""
    return {"emulator.port_link": path, "serial.port": path, "serial.patience": 20.0}


def nodes_of_rig(rig: RigKind, *, with_camera_images: bool = True) -> tuple[str, ...]:
    """Executables that make up a rig, in the order in which they start.

    Parameters
    ----------
    rig : RigKind -- simulated, emulated or real
    with_camera_images : bool -- False leaves the tracker out (the simulator gives displacements itself)

    Returns
    -------
    tuple of str -- keys of NODES
    """
    plant = {
        RigKind.SIMULATED: ("simulator",),
        RigKind.EMULATED: ("firmware_emulator", "hub_driver"),
        RigKind.REAL: ("hub_driver",),
    }[RigKind(rig)]
    tracker = ("vision_tracker",) if with_camera_images else ()
    return (*plant, *tracker, "excitation_generator")
