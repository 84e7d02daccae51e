"""The table of the rig's parameters: what each is, its unit and its range.

The packaged ``config/rig.yaml`` gives every parameter's default; the fields of these classes say what a value may
be. The nodes declare their parameters from them, the ``beam`` command checks its files with them, and the
documentation prints them, so that ``--params-file`` and ``beam --rig-file`` mean the same. Pure: no ROS.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_type_hints

from beam_ident.excitation import RECIPES
from beam_ros.errors import ParameterFileError, likeliest
from beam_ros.interfaces.imperfections import check_imperfections
from beam_ros.interfaces.parameter import Parameter, Value, live, parameters_of, setting

MAX_FACTOR_WITH_IMAGES = 2.0


@dataclass(frozen=True)
class BeamSettings:
    """The strip, its clamp and its damping."""

    length: float = setting("free length of the strip, clamp to tip", "m", 0.01, 5.0)
    width: float = setting("width of the strip", "m", 0.0001, 0.5)
    thickness: float = setting("thickness in the direction of motion", "m", 1e-5, 0.05)
    density: float = setting("density of the strip", "kg/m^3", 10.0, 25000.0)
    youngs_modulus: float = setting("Young's modulus of the strip", "Pa", 1e6, 2e12)
    flexural_rigidity: float = setting(
        "flexural rigidity EI; 0: from youngs_modulus and the section", "N m^2", 0.0, 1e6
    )
    mass_per_length: float = setting(
        "mass of the strip per length; 0: from section and density", "kg/m", 0.0, 1e3
    )
    theory: Literal["euler-bernoulli", "timoshenko"] = setting(
        "theory of bending; timoshenko: with rotary inertia and shear"
    )
    poissons_ratio: float = setting("Poisson's ratio of the strip, for its shear", "1", 0.0, 0.5)
    shear_coefficient: float = setting(
        "shear coefficient of the section; 0: that of a rectangle", "1", 0.0, 1.0
    )
    gravity: Literal["off", "upright", "hanging"] = setting("how the beam stands")
    tip_mass: float = setting("mass at the tip", "kg", 0.0, 10.0)
    tip_inertia: float = setting("rotary inertia of the tip mass", "kg m^2", 0.0, 1.0)
    clamp_stiffness: float = setting("rotary stiffness of the clamp; 0: rigid", "N m/rad", 0.0, 1e9)
    damping_ratios: tuple[float, ...] = setting(
        "damping ratios of the clamped modes; the last one holds for all above", "1", 0.0, 0.5
    )
    viscous_damping: float = setting(
        "viscous damping per length, of the beam's motion relative to the hub", "N s/m^2", 0.0, 1e3
    )
    air_damping: float = setting(
        "viscous damping per length, of the beam's motion in the room", "N s/m^2", 0.0, 1e3
    )
    internal_damping: float = setting("time constant of the Kelvin-Voigt damping in the strip", "s", 0.0, 1.0)
    still_air: bool = setting("added mass and viscous damping of the air, by Sader's theory")
    air_temperature: float = setting("temperature of the air of still_air", "K", 200.0, 400.0)
    air_pressure: float = setting("pressure of the air of still_air", "Pa", 1.0, 1e6)
    max_root_strain: float = setting(
        "bending strain at the clamp; a command that is predicted to exceed it is refused", "1", 1e-6, 0.1
    )
    modes: int = setting("modes that the simulator integrates; 0: what the first five need", "", 0, 20)


@dataclass(frozen=True)
class MarkerSettings:
    """The bright dots that the camera sees; every list from the clamp upwards."""

    names: tuple[str, ...] = setting("names in beam/displacement, from the clamp upwards")
    heights: tuple[float, ...] = setting("heights above the clamp", "m", 0.0, 5.0)
    height_uncertainties: tuple[float, ...] = setting("standard deviations of the heights", "m", 0.0, 0.1)
    masses: tuple[float, ...] = setting("masses of the markers", "kg", 0.0, 1.0)
    diameter: float = setting("diameter of a marker", "m", 0.0001, 0.1)


@dataclass(frozen=True)
class HubSettings:
    """The axis, what it may do, and what the beam on it may bear."""

    mass: float = setting("moving mass of the hub", "kg", 0.001, 1e3)
    travel: float = setting("way of the hub from stop to stop; home is in the middle", "m", 0.001, 10.0)
    max_speed: float = setting("limit of the hub's speed", "m/s", 0.001, 20.0)
    max_acceleration: float = setting("limit of the hub's acceleration", "m/s^2", 0.01, 1e3)
    stop_deceleration: float = setting("deceleration of every stop; 0: max_acceleration", "m/s^2", 0.0, 1e3)
    max_effort: float = setting("limit of the force on the hub", "N", 0.01, 1e4)
    max_following_error: float = setting(
        "largest distance from the hub to where its commands lead it", "m", 1e-6, 1.0
    )
    max_tip_deflection: float = setting(
        "deflection of the tip; a command that is predicted to exceed it is refused", "m", 1e-5, 1.0
    )
    encoder_resolution: float = setting("step of the measured position", "m", 1e-12, 0.001)
    command_mode: Literal["acceleration", "velocity", "position", "effort"] = setting(
        "what a set-point or sequence means"
    )
    applied_hold: Literal["zoh", "linear", "cubic"] = setting("how the applied command runs between ticks")
    measured_hold: Literal["linear", "cubic"] = setting("how the measured position runs between ticks")
    period: float = setting("length of a tick of the device", "s", 0.0001, 0.1)
    watchdog: float = setting("silence until the device stops by itself", "s", 0.05, 4.0)
    homing_speed: float = setting("speed while homing", "m/s", 0.001, 1.0, within=("hub.max_speed", 1.0))
    homing_acceleration: float = setting(
        "acceleration while homing", "m/s^2", 0.001, 1e3, within=("hub.max_acceleration", 1.0)
    )
    move_speed: float = setting(
        "speed of the move to a position set-point", "m/s", 0.001, 20.0, within=("hub.max_speed", 1.0)
    )
    move_acceleration: float = setting(
        "acceleration of the move to a position set-point",
        "m/s^2",
        0.001,
        1e3,
        within=("hub.max_acceleration", 1.0),
    )


@dataclass(frozen=True)
class AxisSettings:
    """How the real axis is reached."""

    kind: str = setting(
        "kind of axis link: beam, trajectory_controller, odrive, dynamixel, csv, or another that a package adds"
    )
    prove_watchdog: bool = setting("fall silent once in every connection and see the device notice")
    accept_no_device_limits: bool = setting(
        "also drive an axis that does not keep the rig's limits by itself"
    )
    accept_no_device_watchdog: bool = setting(
        "also drive an axis that does not stop when this host falls silent"
    )
    drive_watchdog: float = setting(
        "trajectory_controller: silence of its master after which the drive stops, as you state; 0: it does not",
        "s",
        0.0,
        60.0,
    )
    home: Literal["here", "device"] = setting(
        "other controllers: where hub/home finds home: here, or its own zero"
    )
    metres_per_unit: float = setting(
        "other controllers: travel for one turn, radian or count of theirs; negative: reversed",
        "m",
        -1e3,
        1e3,
    )
    rate: float = setting(
        "other controllers: positions written a second, where the host paces them", "Hz", 10.0, 1e3
    )
    options: str = setting("settings of a link that a package adds, as YAML: {gain: 2.0}")


@dataclass(frozen=True)
class SerialSettings:
    """The line to the motion controller."""

    port: str = setting("device or URL of the motion controller")
    baud: int = setting("line speed", "baud", 1200, 12_000_000)
    patience: float = setting("time that a missing port is waited for before it is a fault", "s", 0.0, 60.0)


@dataclass(frozen=True)
class TrajectorySettings:
    """The JointTrajectoryController that moves the hub, for axis.kind trajectory_controller."""

    controller: str = setting("name of the controller")
    joint_states: str = setting("topic of the measured joint states")
    joint: str = setting("name of the hub's joint")
    max_knots: int = setting("most knots in one trajectory; a longer sequence is refused", "", 10, 10_000_000)


@dataclass(frozen=True)
class OdriveSettings:
    """The ODrive that moves the hub, for axis.kind odrive."""

    axis: int = setting("number of its axis", "", 0, 1)


@dataclass(frozen=True)
class DynamixelSettings:
    """The servo that moves the hub, for axis.kind dynamixel."""

    id: int = setting("its number on the bus", "", 0, 252)


@dataclass(frozen=True)
class CsvSettings:
    """What the lines of a board mean, for axis.kind csv; columns are counted from 1, 0: there is none."""

    position_column: int = setting("column of the position, in units of axis.metres_per_unit", "", 1, 100)
    velocity_column: int = setting("column of the velocity, in the same units a second", "", 0, 100)
    effort_column: int = setting("column of the force on the hub", "", 0, 100)
    effort_scale: float = setting("force for one unit of that column", "N", -1e6, 1e6)
    clock_column: int = setting("column of the board's clock", "", 0, 100)
    clock_tick: float = setting("one unit of that clock", "s", 1e-9, 1.0)
    clock_bits: int = setting("bits of the clock's counter, after which it wraps; 0: never", "", 0, 64)


@dataclass(frozen=True)
class EmulatorSettings:
    """The emulated motion controller: of the kind that axis.kind names."""

    firmware: str = setting("python, or the file of a built firmware with a plant port")
    port_link: str = setting("path that links to the pseudo-terminal")
    controller_rate: float = setting("control cycles of an emulated trajectory_controller", "Hz", 10.0, 1e3)
    clock_drift_ppm: float = setting("device clock against the host's", "ppm", -1e3, 1e3)
    line_baud: int = setting("at which bytes travel; 0: as fast as USB", "baud", 0, 12_000_000)
    fifo: int = setting("bytes that wait in each direction; more are lost", "bytes", 64, 1_000_000)
    buffer: int = setting("samples of a sequence that it takes ahead of their time", "", 64, 65535)


@dataclass(frozen=True)
class FaultSettings:
    """What is to go wrong with the emulated axis."""

    schedule: str = setting("file of faults with their times; empty: none")
    request: str = live("faults that happen now, as {fault: unplug, for: 2.0}")


@dataclass(frozen=True)
class CameraSettings:
    """The camera that films the rig, and what it sees."""

    width: int = setting("columns of a frame", "px", 16, 16_384)
    height: int = setting("rows of a frame", "px", 16, 16_384)
    rate: float = setting("frames a second", "Hz", 0.1, 1e4)
    exposure: float = setting("exposure time", "s", 0.0, 1.0)
    readout: float = setting(
        "time from the first row of a frame to its last; 0: global shutter", "s", 0.0, 0.1
    )
    stamp: Literal["start", "mid", "end", "arrival"] = setting("which instant of the exposure a stamp means")
    latency: float = setting("known delay of the stamps", "s", -1.0, 1.0)
    clock_tolerance: float = setting(
        "rate of its clock, relative to the host's; 0: the host stamps", "", 0.0, 0.01
    )
    pixels_per_metre: float = setting("scale in the plane of the beam", "px/m", 1.0, 1e7)
    origin_u: float = setting("column of the beam at rest at home", "px", -1e5, 1e5)
    origin_v: float = setting("row of the clamp", "px", -1e5, 1e5)
    is_mirrored: bool = setting("the camera looks from behind")
    contrast: float = setting("marker above background", "grey levels", 1.0, 255.0)
    background: float = setting("level of the background", "grey levels", 0.0, 254.0)
    blur: float = setting("standard deviation of the optics", "px", 0.0, 20.0)
    noise: float = setting("standard deviation of a pixel", "grey levels", 0.0, 100.0)
    driver: str = setting(
        "whose stamps are known: values of the keys of docs/cameras.md that are not given themselves"
    )
    name: str = setting("the camera, which calibrations keep; empty: not said")
    focus: str = setting("setting of its lens, which calibrations keep; empty: not said")


@dataclass(frozen=True)
class TrackerSettings:
    """Where frames come from, and how markers are found in them."""

    polarity: Literal["bright", "dark"] = setting("markers brighter or darker than the ground")
    source: str = setting(
        "where frames come from: topic, device, file, compressed, or a kind that a package adds"
    )
    device: str = setting("path, number or address of the camera, where the tracker reads it")
    device_format: str = setting("four characters such as GREY, YUYV, MJPG; empty: the driver's choice")
    sets_exposure: bool = setting("set the device to camera.exposure")
    retry_period: float = setting("time until a device that failed is opened again", "s", 0.05, 60.0)
    video: str = setting("video file, for source file")
    video_rate: float = setting("frame rate of the video; 0: as the file says", "Hz", 0.0, 1e6)
    refinement: Literal["none", "radial_symmetry", "disc_model"] = setting(
        "how a marker's position is refined from its centre of gravity"
    )
    prediction: Literal["none", "beam"] = setting(
        "what foretells the markers' places beside their own motion: nothing, or hub/state and the beam's model"
    )
    sigma_floor: float = setting(
        "least standard deviation of a position, as the dots show it at rest; 0: perfect discs",
        "px",
        0.0,
        10.0,
    )
    noise_variance: float = setting(
        "variance of a pixel at level 0, of `beam calibrate camera-noise`; with noise_per_grey 0: the frames tell",
        "grey levels^2",
        -1e6,
        1e6,
    )
    noise_per_grey: float = setting("growth of noise_variance with the level", "grey levels", 0.0, 1e4)
    min_contrast: float = setting("contrast below which nothing is a marker", "grey levels", 1.0, 65535.0)
    aspect: float = setting(
        "width over height of a marker's image: 1 head-on, 0.8 at 37 degrees", "", 0.5, 2.0
    )
    shape_tolerance: float = setting(
        "share by which a marker may differ from a disc, and from itself", "", 0.01, 0.9
    )
    brightness_tolerance: float = setting(
        "share by which one marker's brightness may change where the others keep theirs", "", 0.01, 0.9
    )
    level_fraction: float = setting("share of the contrast below which all counts as ground", "", 0.02, 0.6)
    max_jump: float = setting(
        "farthest from its prediction that a marker is believed by itself", "m", 1e-5, 1.0
    )
    row_gate: float = setting("farthest that a frame takes a marker across the rows", "m", 1e-5, 1.0)
    row_tolerance: float = setting("tolerance of the rows in which markers are expected", "m", 1e-5, 1.0)
    region: tuple[float, ...] = setting(
        "part of the picture in which markers are looked for: first and last column, first and last row",
        "px",
        0.0,
        16384.0,
    )
    averaged_frames: int = live("frames averaged for a tare or a calibration point", "", 2, 100_000)
    drawing_rate: float = live("largest rate of beam/shape and tracker/debug_image", "Hz", 0.1, 1e3)
    calibration: str = setting("calibration file; empty: the nominal scale")
    save_calibration: str = live("file for tracker/fit_calibration to write")


@dataclass(frozen=True)
class SimulationSettings:
    """What a simulation adds or leaves out."""

    images: bool = setting("film the beam; else displacements are published directly")
    displacement_noise: float = setting(
        "standard deviation of the displacements without images", "m", 0.0, 0.01
    )
    preset: Literal["ideal", "realistic"] = setting("values of all keys below that are not given themselves")
    drag_coefficient: float = setting("C_d of the strip in air; 0: no drag", "1", 0.0, 100.0)
    large_deflections: bool = setting("cubic inertia, curvature and weight of the bent beam")
    friction_coulomb: float = setting("dry friction of the hub's guide", "N", 0.0, 1e3)
    friction_static: float = setting("force that breaks the hub loose; 0: Coulomb's", "N", 0.0, 1e3)
    friction_viscous: float = setting("viscous friction of the hub's guide", "N s/m", 0.0, 1e4)
    friction_coulomb_difference: float = setting("dry friction along +x less that along -x", "N", -2e3, 2e3)
    friction_viscous_difference: float = setting(
        "viscous friction along +x less along -x", "N s/m", -2e4, 2e4
    )
    servo_frequency: float = setting(
        "natural frequency of the servo on the moving mass; 0: an axis that follows exactly", "Hz", 0.0, 1e3
    )
    servo_damping: float = setting("damping ratio of the servo", "1", 0.0, 5.0)
    backlash: float = setting("play between drive and hub", "m", 0.0, 0.001)
    end_stops: bool = setting("hard stops at both ends of hub.travel")
    stop_restitution: float = setting("share of the speed that a stop gives back", "1", 0.0, 1.0)
    ripple: float = setting("amplitude of the actuator's force ripple", "N", 0.0, 1e3)
    ripple_period: float = setting("travel after which the ripple repeats", "m", 1e-5, 1.0)
    encoder_noise: float = setting("standard deviation of the measured position", "m", 0.0, 0.001)
    encoder_at: Literal["hub", "drive"] = setting(
        "what the encoder measures: hub, or the drive before its play"
    )
    hub_clock_ppm: float = setting("clock of the simulated device against the host's", "ppm", -1e3, 1e3)
    camera_clock_ppm: float = setting("clock of the simulated camera against the host's", "ppm", -1e3, 1e3)
    stamp_offset: float = setting("delay of the frames' stamps, which nobody knows", "s", -2.0, 2.0)
    stamp_jitter: float = setting("standard deviation of the frames' stamps", "s", 0.0, 0.01)
    frame_drops: float = setting("share of the frames that get lost", "1", 0.0, 0.5)
    full_well: float = setting("electrons at grey level 255; 0: no shot noise", "", 0.0, 1e6)
    real_time_factor: float = setting("speed of simulated time", "1", 0.01, 20.0)
    seed: int = setting("seed of all simulated noise", "", 0, 2**31 - 1)


@dataclass(frozen=True)
class ExcitationSettings:
    """The signal that moves the hub; docs/excitation.md says what each kind reads."""

    kind: str = live("signal that moves the hub", choices=tuple(RECIPES))
    acceleration: float = live(
        "amplitude of the chirp's acceleration, and of the other signals'",
        "m/s^2",
        0.0001,
        1e3,
        within=("hub.max_acceleration", 1.0),
    )
    max_displacement: float = live(
        "amplitude of the displacement, which limits the signal at low frequency",
        "m",
        1e-6,
        5.0,
        within=("hub.travel", 0.5),
    )
    start_frequency: float = live("lowest frequency of the signal", "Hz", 0.001, 1e4)
    end_frequency: float = live("highest frequency of the signal", "Hz", 0.001, 1e4)
    duration: float = live("length of the excitation, without the still hub afterwards", "s", 0.01, 3600.0)
    still: float = live("time that the hub stands still after the excitation", "s", 0.0, 3600.0)
    step_size: float = live("displacement of the step", "m", -1.0, 1.0, within=("hub.travel", 0.5))
    rise_time: float = live("rise time of the step", "s", 0.001, 60.0)
    seed: int = live("seed of random phases, lines and noise", "", 0, 2**31 - 1)
    max_velocity: float = live(
        "amplitude of the hub's velocity; 0: no ceiling", "m/s", 0.0, 10.0, within=("hub.max_speed", 1.0)
    )
    max_jerk: float = live("jerk above which the signal is refused; 0: no limit", "m/s^3", 0.0, 1e9)
    line_period: float = live(
        "period of the multisine; 0: near 10 s, a part of the duration", "s", 0.0, 3600.0
    )
    lines: Literal["full", "odd", "random_odd"] = live(
        "which multiples of the lowest frequency the multisine has"
    )
    detection_group: int = live("random_odd: one odd line left out of so many", "", 2, 100)
    phases: Literal["random", "schroeder", "crest"] = live(
        "how the phases of the multisine's lines are chosen"
    )
    drive: Literal["acceleration", "velocity", "position"] = live(
        "quantity whose levels prbs, pulse and doublet set"
    )
    speed: float = live(
        "level of signals in velocity, and largest speed of the moves",
        "m/s",
        1e-6,
        10.0,
        within=("hub.max_speed", 1.0),
    )
    edge_time: float = live("length of the smooth edges of prbs, pulse and doublet", "s", 0.0, 60.0)
    clock_period: float = live("shortest time between two changes of the prbs", "s", 1e-5, 60.0)
    order: int = live("order of the prbs: its period has 2^order - 1 clocks", "", 3, 18)
    inverse_repeat: bool = live("prbs: each period, then its negative")
    high_pass: float = live("frequency below which the content of the prbs is taken out", "Hz", 0.0, 1e3)
    width: float = live("length of pulse and doublet", "s", 0.0001, 60.0)
    gap: float = live("time between pulses and doublets of a train", "s", 0.0, 60.0)
    frequencies: tuple[float, ...] = live(
        "frequencies of the stepped sine, in turn, or of the shaped multisine, increasing", "Hz", 0.001, 1e4
    )
    amplitudes: tuple[float, ...] = live(
        "amplitudes of the shaped multisine's lines, against each other", "", 1e-9, 1e9
    )
    line_phases: tuple[float, ...] = live("phases of the shaped multisine's lines", "rad", -1e3, 1e3)
    settle_cycles: float = live(
        "cycles of the stepped sine that are waited for at each frequency", "1", 0.0, 1e5
    )
    measure_cycles: int = live(
        "cycles of the stepped sine that are measured at each frequency", "", 1, 100_000
    )
    waypoints: tuple[float, ...] = live(
        "way-points of the moves; the last is 0", "m", -1.0, 1.0, within=("hub.travel", 0.5)
    )
    profile: Literal["bounded_jerk", "quintic", "cycloidal"] = live("how speed grows and falls in the moves")
    jerk: float = live("largest jerk of the moves", "m/s^3", 0.001, 1e6)
    dwell: float = live("time of rest at every way-point, and around a shaped move", "s", 0.0, 3600.0)
    move_from: float = live("where a shaped move begins", "m", -1.0, 1.0, within=("hub.travel", 0.5))
    move_to: float = live("where it ends", "m", -1.0, 1.0, within=("hub.travel", 0.5))
    move_aim: float = live("swing below which a shaped move was made to stay", "m", 1e-9, 1.0)
    command_period: float = live("tick for which a shaped move was made", "s", 1e-6, 1.0)
    command: tuple[float, ...] = live(
        "accelerations of a shaped move at its ticks; beam shape writes them", "m/s^2", -1e3, 1e3
    )
    file: str = live("file of columns with a trajectory of one's own: its time, and one motion")
    file_values: str = live("its position, velocity or acceleration, as x,unit=mm; empty: found by its unit")
    file_time: str = live("its time, as t,unit=ms, or rate=1000 [Hz] of its rows; empty: found by its name")
    start_delay: float = live(
        "time from handing a sequence over to its start; a busy computer needs longer", "s", 0.5, 60.0
    )


@dataclass(frozen=True)
class RecorderSettings:
    """The bag that a recording goes to."""

    path: str = live("folder of the bag; empty: runs/<date>")
    images: bool = live("record camera frames too")
    start_at_launch: bool = setting("record from the node's start")
    max_size: int = live(
        "size of a file of the bag, after which the next begins; 0: no limit", "MB", 0, 1_000_000
    )
    max_duration: float = live(
        "length of a file of the bag, after which the next begins; 0: no limit", "s", 0.0, 1e6
    )
    min_free: int = live("space on the disk below which the recording ends; 0: none", "MB", 0, 1_000_000_000)
    operator: str = live("who runs the experiment; empty: the user of the machine")


@dataclass(frozen=True)
class PlayerSettings:
    """The bag that is played back."""

    bag: str = setting("folder of the bag")
    rate: float = setting("speed of the replay", "1", 0.01, 100.0)
    commands: bool = setting("also replay what moves an axis")
    start: float = setting("where the replay begins, after the bag's first message", "s", 0.0, 1e6)
    loop: bool = setting("begin anew at the end, until it is ended")
    paused: bool = setting("stand still at first, for player/step and player/pause")
    clock: bool = setting("publish the bag's time on /clock")


@dataclass(frozen=True)
class IdentifierSettings:
    """The bag that is identified, and how."""

    bag: str = live("folder of the bag, or a file of columns; several with ; between are one fit")
    validate: str = live("bags that the model is scored on, with ; between")
    report: str = live("folder for report and model; empty: beside the bag")
    overwrite: bool = live("write over a report that is there")
    estimator: str = live("how to estimate; `beam identify --help` lists the estimators")
    modes: int = live("number of modes; 0: from the data", "", 0, 20)
    max_modes: int = live("most modes that are tried where modes is 0; 0: as many as usual", "", 0, 30)
    orders: str = live(
        "poles/zeros to choose from, 4/3,5/4, of transfer functions and po_moesp; empty: by modes"
    )
    structure: Literal[
        "auto", "base_motion", "velocity", "acceleration", "force", "receptance", "mobility", "accelerance"
    ] = live("which model fits which input")
    without: str = live("terms left out of the model: residual, offset, ramp, free_response")
    delay: str = live("delay of the outputs [s]: auto, free, 0.004, or 0.004+-0.001")
    clock: str = live("rate of the outputs' clock against the input's, less one: auto, free, 20e-6, 0+-50e-6")
    hold: Literal["auto", "zoh", "linear", "cubic", "band_limited"] = live(
        "what the input does between samples; auto: as the rig or the signal says"
    )
    noise: Literal["auto", "white", "modelled"] = live(
        "noise of transfer functions: as it is, as if white, or coloured"
    )
    segments: str = live("parts of each bag that are used [s from its first sample], 0:10,12:20; empty: all")
    amplitude: bool = live(
        "also curves of frequency and damping over amplitude, from decays at the bags' ends or from several levels"
    )
    best_linear: bool = live(
        "also response, noise and nonlinear distortion line by line, from bags of one multisine with other seeds"
    )
    axis: bool = live("also mass and friction of the hub's axis, from the force on it and its position")
    drive_mass: float = live(
        "with axis also the stiffness of a compliant drive, of this mass ahead of its spring, J/r^2 of a rotor; "
        "0: not looked for, or unknown",
        "kg",
        0.0,
        1e4,
    )
    encoder: Literal["hub", "drive"] = live(
        "with axis whose position the axis measures; drive: the stiffness is looked for, also of an unknown mass"
    )
    input: str = live("TOPIC:FIELD of the input, or a file's column; empty: the hub")
    outputs: str = live(
        "TOPIC:FIELD of every output, or a file's columns, with ; between; empty: the markers"
    )
    time: str = live("a file's column with the time, or rate=1000 [Hz] of its rows; empty: found by its name")
    signals: str = live("YAML file of input and outputs")
    operator: str = live("who answers for the experiment, for the report")
    temperature_uncertainty: float = live(
        "how well the beam's temperature is known, standard deviation, for the report's budget; 0: not counted",
        "K",
        0.0,
        100.0,
    )
    figures: Literal["none", "sheet", "all"] = live(
        "which figures the report draws: none, those of the sheet to sign, or those of the evidence behind it too"
    )
    pdf: bool = live("print the report to report.pdf, by an installed Chromium")


@dataclass(frozen=True)
class LiveSettings:
    """The estimate that grows while the rig runs."""

    aims: str = setting("relative standard deviations that are asked, f1:0.01%, zeta1:2%; empty: none")
    share_of_core: float = setting("part of one processor's time that the estimates may take", "1", 0.01, 1.0)
    memory: float = setting("how much of the record is kept for the estimates, the newest", "s", 1.0, 1e5)
    niceness: int = setting("how far the estimates let everything else go first; 0: not at all", "", 0, 19)


@dataclass(frozen=True)
class RigParameters:
    """Every parameter of the rig: a group for each section of the rig file."""

    beam: BeamSettings
    markers: MarkerSettings
    hub: HubSettings
    axis: AxisSettings
    serial: SerialSettings
    trajectory: TrajectorySettings
    odrive: OdriveSettings
    dynamixel: DynamixelSettings
    csv: CsvSettings
    emulator: EmulatorSettings
    faults: FaultSettings
    camera: CameraSettings
    tracker: TrackerSettings
    simulation: SimulationSettings
    excitation: ExcitationSettings
    recorder: RecorderSettings
    player: PlayerSettings
    identifier: IdentifierSettings
    live: LiveSettings

    def __getitem__(self, name: str) -> Any:
        """Return a parameter's value by its dotted name, for code that goes through the whole table."""
        group, _, leaf = name.partition(".")
        return getattr(getattr(self, group), leaf)


GROUPS = get_type_hints(RigParameters)
"""The class of each group by the group's name."""

RIG_PARAMETERS: dict[str, Parameter] = {
    parameter.name: parameter
    for group, settings in GROUPS.items()
    for parameter in parameters_of(settings, group)
}
"""Every parameter by its dotted name."""


def check_parameters(values: Mapping[str, object]) -> dict[str, Value]:
    """Check dotted names and values against the table and return them in their types.

    Raises
    ------
    ParameterFileError
        A name is unknown, or a value has a wrong type, word or range.
    """
    for name in values:
        if name not in RIG_PARAMETERS:
            raise _unknown_parameter(name)
    return {name: RIG_PARAMETERS[name].check(value) for name, value in values.items()}


def _unknown_parameter(name: str) -> ParameterFileError:
    stem = re.sub(r"_(mm|cm|um|ms|us|hz|khz|gpa|mpa|deg|g)$", "", name, flags=re.IGNORECASE)
    known = RIG_PARAMETERS.get(likeliest(stem, RIG_PARAMETERS))
    unit = f" [{known.unit}]" if known and known.unit else ""
    hint = f"did you mean {known.name}{unit}?" if known else "`beam model --parameters` lists what there is"
    return ParameterFileError(f"unknown parameter {name}: {hint}")


def check_relations(rig: RigParameters, given: Iterable[str] = ()) -> None:
    """Check what no single parameter can say of itself.

    Parameters
    ----------
    rig : RigParameters
    given : iterable of str
        Names that are being set. What another parameter limits is checked where it is set, so that a smaller
        hub does not forbid a rig whose excitation nobody has asked for.

    Raises
    ------
    ParameterFileError
        Lists of markers of unequal length, heights out of order or above the tip, a band upside down, a magnitude
        beyond the hub's limit, an imperfection that would do nothing.
    """
    for name in given:
        _check_within(rig, RIG_PARAMETERS[name])
    names, heights = rig.markers.names, rig.markers.heights
    for key, column in vars(rig.markers).items():
        if isinstance(column, tuple) and len(column) != len(names):
            raise ParameterFileError(
                f"markers.{key} has {len(column)} entries for {len(names)} markers: expected one per name in "
                "markers.names; add or remove entries"
            )
    if len(set(names)) != len(names):
        raise ParameterFileError(
            f"markers.names is {list(names)}: expected every name once; rename the doubled one"
        )
    if sorted(set(heights)) != list(heights):
        raise ParameterFileError(
            f"markers.heights is {list(heights)} m: expected heights that rise from the clamp; sort names, "
            "heights and masses together"
        )
    if heights[-1] > rig.beam.length:
        raise ParameterFileError(
            f"markers.heights ends at {heights[-1]:g} m, above the tip at beam.length = {rig.beam.length:g} m: "
            "give heights in metres from the clamp"
        )
    if rig.axis.metres_per_unit == 0.0:
        raise ParameterFileError(
            "axis.metres_per_unit is 0: expected the hub's travel for one turn, radian or count of the controller; "
            "measure it with a ruler over many turns"
        )
    factor = rig.simulation.real_time_factor
    if rig.simulation.images and factor > MAX_FACTOR_WITH_IMAGES:
        raise ParameterFileError(
            f"simulation.real_time_factor is {factor:g} with simulation.images: expected at most "
            f"{MAX_FACTOR_WITH_IMAGES:g}, the most that images over DDS keep up with; switch the images off, or use "
            "`beam simulate`, which needs no real time"
        )
    check_imperfections(rig)
    start, end = rig.excitation.start_frequency, rig.excitation.end_frequency
    if not start < end:
        raise ParameterFileError(
            f"excitation.start_frequency is {start:g} Hz and excitation.end_frequency {end:g} Hz: expected "
            "the start below the end"
        )


def _check_within(rig: RigParameters, parameter: Parameter) -> None:
    if parameter.within is None:
        return
    limiting, share = parameter.within
    limit = share * rig[limiting]
    value = rig[parameter.name]
    largest = max(map(abs, value)) if isinstance(value, tuple) else abs(value)
    if largest > limit:
        part = "" if share == 1.0 else f"{share:g} times "
        raise ParameterFileError(
            f"{parameter.name} is {largest:g} {parameter.unit}: expected at most {limit:g} {parameter.unit}, "
            f"{part}{limiting}; lower it, or set {limiting} to what the axis can do"
        )
