"""The rig as one object: checked parameters, and what the rooms make of them.

A ``Rig`` holds every parameter of the table; its methods build the typed parameters that the model, the hub,
the camera and the tracker want. Rooms are imported only when their part is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces.camera_drivers import with_driver
from beam_ros.interfaces.imperfections import with_preset
from beam_ros.interfaces.parameter import Value
from beam_ros.interfaces.parameter_files import flatten, packaged_defaults, parameters_in_file
from beam_ros.interfaces.rig_parameters import GROUPS, RigParameters, check_parameters, check_relations

if TYPE_CHECKING:
    from beam_model import BeamModel, BeamParameters
    from beam_ros.hub.gate.beam_guard import BeamGuard
    from beam_ros.hub.link_parameters import (
        CsvColumns,
        DynamixelParameters,
        OdriveParameters,
        TrajectoryParameters,
    )
    from beam_ros.hub.parameters import AxisParameters, LinkParameters, SimulatedDevice
    from beam_ros.hub.simulated.plant import Plant
    from beam_ros.vision.measurement.motion_prediction import BeamMotion
    from beam_ros.vision.parameters import CameraParameters, TrackerParameters


_BEND = 2.0
"""A beam that swings freely may bend further than any command may bend it: by so many times as much."""


class Rig(RigParameters):
    """A complete, checked set of the rig's parameters: ``rig.hub.travel`` is the parameter ``hub.travel``."""

    @classmethod
    def from_file(cls, path: Path | None = None) -> Rig:
        """Read a ROS parameter file on top of the packaged defaults.

        Parameters
        ----------
        path : Path, optional -- None: the packaged rig as it is

        Raises
        ------
        ParameterFileError
            The file is missing or wrong.
        """
        given = {} if path is None else parameters_in_file(path)
        return cls._of(packaged_defaults()).with_values(given, source=f"{path}: " if path else "")

    @classmethod
    def from_nested(cls, tree: Mapping[str, Any]) -> Rig:
        """Build a rig from nested groups, as ``to_nested`` gives them.

        Raises
        ------
        ParameterFileError
            A name is unknown or a value wrong.
        """
        return cls._of(packaged_defaults()).with_values(dict(flatten(tree)))

    @property
    def values(self) -> dict[str, Value]:
        """Every parameter's value by its dotted name."""
        return dict(flatten(self.to_nested()))

    def with_values(self, changes: Mapping[str, object], source: str = "") -> Rig:
        """Return the rig with some parameters changed.

        Parameters
        ----------
        changes : mapping -- dotted names and new values; a ``simulation.preset`` among them also gives the keys that
            it sets, where they are not among them themselves
        source : str -- put before an error's message: the file the values come from

        Raises
        ------
        ParameterFileError
            A name is unknown or a value wrong.
        """
        try:
            checked = with_driver(with_preset(check_parameters(changes)))
            rig = self._of({**self.values, **checked})
            check_relations(rig, [name for name in checked if rig[name] != self[name]])
        except ParameterFileError as err:
            raise ParameterFileError(f"{source}{err}") from err
        return rig

    @classmethod
    def _of(cls, values: Mapping[str, Value]) -> Rig:
        groups: dict[str, dict[str, Any]] = {group: {} for group in GROUPS}
        for name, value in values.items():
            group, _, leaf = name.partition(".")
            groups[group][leaf] = value
        return cls(**{group: GROUPS[group](**members) for group, members in groups.items()})

    def with_texts(self, assignments: Iterable[str]) -> Rig:
        """Return the rig with parameters changed as on a command line.

        Parameters
        ----------
        assignments : iterable of str -- "name:=value", the value in YAML

        Raises
        ------
        ParameterFileError
            An assignment has another form, or its name or value is wrong.
        """
        changes: dict[str, object] = {}
        for text in assignments:
            name, separator, value = text.partition(":=")
            if not separator or not name:
                raise ParameterFileError(
                    f"{text!r} sets no parameter: expected name:=value, as camera.rate:=50.0"
                )
            try:
                changes[name] = YAML(typ="safe", pure=True).load(value) if value else ""
            except YAMLError as err:
                raise ParameterFileError(
                    f"{text!r} has no YAML value after `:=`; quote it or mend it"
                ) from err
        return self.with_values(changes)

    def to_nested(self) -> dict[str, Any]:
        """Parameters in nested groups, as in the file."""
        return {group: dict(vars(getattr(self, group))) for group in GROUPS}

    def write(self, path: Path) -> None:
        """Write a ROS parameter file with every parameter."""
        document = {"/**": {"ros__parameters": self.to_nested()}}
        yaml = YAML(typ="safe", pure=True)
        yaml.default_flow_style = False  # ROS reads no colon within braces
        with path.open("w", encoding="utf-8") as stream:
            yaml.dump(document, stream)

    def beam_parameters(self) -> BeamParameters:
        """The beam's physics, for ``beam_model``."""
        from beam_model import BeamParameters, Damping, PointMass, StillAir

        masses = zip(self.markers.heights, self.markers.masses, strict=True)
        common: dict[str, Any] = {
            "hub_mass": self.hub.mass,
            "tip_mass": self.beam.tip_mass,
            "tip_inertia": self.beam.tip_inertia,
            "gravity": self.beam.gravity,
            "point_masses": tuple(PointMass(height, mass) for height, mass in masses if mass > 0.0),
            "clamp_stiffness": self.beam.clamp_stiffness or float("inf"),
            "damping": Damping(
                ratios=self.beam.damping_ratios,
                viscous=self.beam.viscous_damping,
                air=self.beam.air_damping,
                internal=self.beam.internal_damping,
            ),
            "theory": self.beam.theory,
            "air": StillAir(self.beam.air_temperature, self.beam.air_pressure)
            if self.beam.still_air
            else None,
        }
        section = BeamParameters.from_section(
            length=self.beam.length,
            width=self.beam.width,
            thickness=self.beam.thickness,
            density=self.beam.density,
            youngs_modulus=self.beam.youngs_modulus,
            poissons_ratio=self.beam.poissons_ratio,
            shear_coefficient=self.beam.shear_coefficient,
            **common,
        )
        rigidity = self.beam.flexural_rigidity or section.flexural_rigidity
        mass_per_length = self.beam.mass_per_length or section.mass_per_length
        return replace(section, flexural_rigidity=rigidity, mass_per_length=mass_per_length)

    def beam_model(self) -> BeamModel:
        """The Galerkin model with the rig's number of modes, or as many as its first five need."""
        from beam_model import BeamModel

        return BeamModel(self.beam_parameters(), n_modes=self.beam.modes or None)

    def simulated_plant(
        self, model: BeamModel, clock_drift_ppm: float, period_ns: int | None = None
    ) -> Plant:
        """The beam on its hub with the simulated hardware's imperfections.

        Parameters
        ----------
        model : BeamModel -- of ``beam_model``
        clock_drift_ppm : float -- by how much the device's clock runs fast [1e-6]
        period_ns : int, optional -- the device's tick, where it is another than the rig's [ns]
        """
        from beam_model import AirDrag, EndStops, HubFriction, NonlinearTerms
        from beam_ros.hub.simulated.mechanism import Mechanism, servo_on
        from beam_ros.hub.simulated.plant import beam_on_axis

        simulation = self.simulation
        drag = AirDrag(self.beam.width, simulation.drag_coefficient)
        terms = None
        if simulation.large_deflections or simulation.drag_coefficient:
            terms = NonlinearTerms(model, drag, simulation.large_deflections)
        limit = self.hub.travel / 2
        servo = None
        if simulation.servo_frequency:
            servo = servo_on(
                model.parameters.total_mass,
                frequency_hz=simulation.servo_frequency,
                damping_ratio=simulation.servo_damping,
                max_force=self.hub.max_effort,
                backlash=simulation.backlash,
            )
        mechanism = Mechanism(
            friction=HubFriction(
                simulation.friction_coulomb,
                simulation.friction_viscous,
                simulation.friction_static,
                simulation.friction_coulomb_difference,
                simulation.friction_viscous_difference,
            ),
            stops=EndStops(-limit, limit, simulation.stop_restitution) if simulation.end_stops else None,
            servo=servo,
            ripple=simulation.ripple,
            ripple_period=simulation.ripple_period,
        )
        parameters = self.axis_parameters()
        if period_ns is not None:
            parameters = replace(parameters, period_ns=period_ns)
        return beam_on_axis(model, parameters, terms, mechanism, clock_drift_ppm=clock_drift_ppm)

    def simulated_device(self, clock_drift_ppm: float, clock_start_ns: int = 0) -> SimulatedDevice:
        """The simulated or emulated device: its clock [1e-6], what that reads at power-on [ns], its encoder."""
        from beam_ros.hub.parameters import SimulatedDevice

        return SimulatedDevice(
            clock_drift_ppm=clock_drift_ppm,
            clock_start_ns=clock_start_ns,
            encoder_noise=self.simulation.encoder_noise,
            encoder_at=self.simulation.encoder_at,
            seed=self.simulation.seed,
        )

    def axis_parameters(self) -> AxisParameters:
        """The axis and its controller: limits, command mode, tick and watchdog."""
        from beam_ros.hub.parameters import AxisParameters

        return AxisParameters(
            travel=self.hub.travel,
            max_speed=self.hub.max_speed,
            max_acceleration=self.hub.max_acceleration,
            stop_deceleration=self.hub.stop_deceleration or self.hub.max_acceleration,
            max_effort=self.hub.max_effort,
            max_following_error=self.hub.max_following_error,
            encoder_resolution=self.hub.encoder_resolution,
            command_mode=self.hub.command_mode,
            period_ns=round(self.hub.period * 1e9),
            watchdog_s=self.hub.watchdog,
            homing_speed=self.hub.homing_speed,
            homing_acceleration=self.hub.homing_acceleration,
            move_speed=self.hub.move_speed,
            move_acceleration=self.hub.move_acceleration,
        )

    def beam_guard(self) -> BeamGuard:
        """What the hub may do to the beam: the guard of every set-point and sequence."""
        from beam_ros.hub.gate.beam_guard import BeamGuard, BeamLimits

        limits = BeamLimits(self.hub.max_tip_deflection, self.beam.max_root_strain, self.hub.max_effort)
        return BeamGuard(self.beam_model(), self.beam.thickness, limits, self.axis_parameters())

    def link_parameters(self) -> LinkParameters:
        """How the real axis is reached."""
        from beam_ros.hub.parameters import LinkParameters

        return LinkParameters(
            self.serial.port,
            self.serial.baud,
            self.serial.patience,
            prove_watchdog=self.axis.prove_watchdog,
        )

    def trajectory_parameters(self) -> TrajectoryParameters:
        """How a JointTrajectoryController moves the hub."""
        from beam_ros.hub.link_parameters import TrajectoryParameters

        return TrajectoryParameters(
            metres_per_unit=self.axis.metres_per_unit,
            max_knots=self.trajectory.max_knots,
            homes_here=self.axis.home == "here",
            drive_watchdog_s=self.axis.drive_watchdog,
        )

    def odrive_parameters(self) -> OdriveParameters:
        """How an ODrive moves the hub."""
        from beam_ros.hub.link_parameters import OdriveParameters

        return OdriveParameters(*self._drive(), axis=self.odrive.axis)

    def dynamixel_parameters(self) -> DynamixelParameters:
        """How a Dynamixel servo moves the hub."""
        from beam_ros.hub.link_parameters import DynamixelParameters

        return DynamixelParameters(*self._drive(), servo_id=self.dynamixel.id)

    def _drive(self) -> tuple[float, float, bool]:
        return self.axis.metres_per_unit, self.axis.rate, self.axis.home == "here"

    @property
    def lacks_port(self) -> bool:
        """Whether the axis is behind a serial port that is not named."""
        return self.axis.kind in ("beam", "odrive", "dynamixel", "csv") and not self.serial.port

    def csv_columns(self) -> CsvColumns:
        """What the lines of a board mean."""
        from beam_ros.hub.link_parameters import CsvColumns

        return CsvColumns(
            position=self.csv.position_column,
            velocity=self.csv.velocity_column,
            effort=self.csv.effort_column,
            clock=self.csv.clock_column,
            position_scale=self.axis.metres_per_unit,
            effort_scale=self.csv.effort_scale,
            clock_tick=self.csv.clock_tick,
            clock_bits=self.csv.clock_bits,
        )

    def axis_options(self) -> dict[str, Any]:
        """Settings of an axis link that a package adds.

        Raises
        ------
        ParameterFileError
            ``axis.options`` is no YAML mapping.
        """
        text = self.axis.options
        try:
            options = YAML(typ="safe", pure=True).load(text) if text else {}
        except YAMLError:
            options = None
        if not isinstance(options, dict):
            raise ParameterFileError(
                f"axis.options is {text!r}: expected a mapping in YAML, as {{gain: 2.0, port: /dev/ttyUSB0}}; mend it"
            )
        return options

    def camera_parameters(self) -> CameraParameters:
        """The camera and what it sees."""
        from beam_ros.vision.parameters import CameraParameters

        contrast, background = self.camera.contrast, self.camera.background
        if self.tracker.polarity == "dark":
            # Where the ground leaves dark markers no room, the picture is the negative of that with bright ones.
            if background < contrast <= 255.0 - background:
                background = 255.0 - background
            contrast = -contrast
        return CameraParameters(
            width=self.camera.width,
            height=self.camera.height,
            rate_hz=self.camera.rate,
            exposure_s=self.camera.exposure,
            readout_s=self.camera.readout,
            pixels_per_metre=self.camera.pixels_per_metre,
            origin_px=(self.camera.origin_u, self.camera.origin_v),
            flip=self.camera.is_mirrored,
            marker_diameter_m=self.markers.diameter,
            contrast=contrast,
            background=background,
            strip_width_m=self.beam.thickness,
            blur_px=self.camera.blur,
            noise_grey=self.camera.noise,
            stamp=self.camera.stamp,
            latency_s=self.camera.latency,
            name=self.camera.name,
            focus=self.camera.focus,
        )

    def beam_motion(self) -> BeamMotion | None:
        """What foretells the markers' places; None where ``tracker.prediction`` is none."""
        if self.tracker.prediction == "none":
            return None
        from beam_ros.vision.measurement.motion_prediction import BeamMotion

        model = self.beam_model()
        return BeamMotion(
            model.natural_frequencies,
            model.damping_ratios,
            model.participation_factors,
            model.shape(self.markers.heights),
            self.hub.max_acceleration,
            self.hub.encoder_resolution / math.sqrt(12.0),
        )

    def tracker_parameters(self) -> TrackerParameters:
        """What the tracker expects to see."""
        from beam_ros.vision.parameters import PERFECT_DISC_SIGMA_PX, TrackerParameters

        tracker, scale = self.tracker, self.camera.pixels_per_metre
        line = tracker.noise_variance, tracker.noise_per_grey
        return TrackerParameters.for_camera(
            self.camera_parameters(),
            self.markers.heights,
            refinement=tracker.refinement,
            sigma_floor_px=max(tracker.sigma_floor, PERFECT_DISC_SIGMA_PX),
            min_contrast_grey=tracker.min_contrast,
            max_bend_px=_BEND * self.hub.max_tip_deflection * scale,
            aspect=tracker.aspect,
            level_fraction=tracker.level_fraction,
            max_jump_px=max(tracker.max_jump * scale, 1.0),
            row_gate_px=max(tracker.row_gate * scale, 0.5),
            expected_row_tolerance_px=tracker.row_tolerance * scale,
            region_px=tracker.region,
            shape_tolerance=tracker.shape_tolerance,
            brightness_tolerance=tracker.brightness_tolerance,
            noise_line=line if any(line) else None,
        )
