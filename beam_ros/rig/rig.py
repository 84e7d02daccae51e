"""The rig as one object: checked parameters, and what the rooms make of them.

A ``Rig`` holds every parameter of the schema; its methods build the typed parameters that the model, the hub,
the camera and the tracker want. Rooms are imported only when their part is asked for.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces import schema

if TYPE_CHECKING:
    from beam_model import BeamModel, BeamParameters, NonlinearTerms
    from beam_ros.hub.parameters import HubParameters
    from beam_ros.vision.camera.capture import DeviceSettings
    from beam_ros.vision.parameters import CameraParameters, TrackerParameters


@dataclass(frozen=True)
class Rig:
    """A complete, checked set of the rig's parameters.

    Attributes
    ----------
    values : mapping -- dotted name to value, for every parameter of the schema
    """

    values: Mapping[str, schema.Value]

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
        given = {} if path is None else schema.parameters_in_file(path)
        return cls(schema.packaged_defaults()).with_values(given, source=f"{path}: " if path else "")

    @classmethod
    def from_nested(cls, tree: Mapping[str, Any]) -> Rig:
        """Build a rig from nested groups, as ``to_nested`` gives them.

        Raises
        ------
        ParameterFileError
            A name is unknown or a value wrong.
        """
        return cls(schema.packaged_defaults()).with_values(dict(schema.flatten(tree)))

    def __getitem__(self, name: str) -> schema.Value:
        """Value of a parameter by its dotted name."""
        return self.values[name]

    def number(self, name: str) -> float:
        """Value of a numeric parameter."""
        value = self.values[name]
        assert isinstance(value, (int, float))
        return float(value)

    def numbers(self, name: str) -> tuple[float, ...]:
        """Values of a parameter that is a list of numbers."""
        value = self.values[name]
        assert isinstance(value, list)
        return tuple(float(item) for item in value)

    def text(self, name: str) -> str:
        """Value of a parameter that is text."""
        value = self.values[name]
        assert isinstance(value, str)
        return value

    @property
    def marker_names(self) -> tuple[str, ...]:
        """Names of the markers, from the clamp upwards."""
        value = self.values["markers.names"]
        assert isinstance(value, list)
        return tuple(str(item) for item in value)

    def with_values(self, changes: Mapping[str, object], source: str = "") -> Rig:
        """Return the rig with some parameters changed.

        Parameters
        ----------
        changes : mapping -- dotted names and new values
        source : str -- put before an error's message: the file the values come from

        Raises
        ------
        ParameterFileError
            A name is unknown or a value wrong.
        """
        try:
            values = {**self.values, **schema.check_parameters(changes)}
            schema.check_relations(values)
        except ParameterFileError as err:
            raise ParameterFileError(f"{source}{err}") from err
        return Rig(values)

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
        tree: dict[str, Any] = {}
        for name, value in self.values.items():
            group, _, leaf = name.partition(".")
            tree.setdefault(group, {})[leaf] = value
        return tree

    def write(self, path: Path) -> None:
        """Write a ROS parameter file with every parameter."""
        document = {"/**": {"ros__parameters": self.to_nested()}}
        yaml = YAML(typ="safe", pure=True)
        yaml.default_flow_style = None
        with path.open("w", encoding="utf-8") as stream:
            yaml.dump(document, stream)

    def beam_parameters(self) -> BeamParameters:
        """The beam's physics, for ``beam_model``."""
        from beam_model import BeamParameters, Damping, PointMass

        masses = zip(self.numbers("markers.heights"), self.numbers("markers.masses"), strict=True)
        common: dict[str, Any] = {
            "hub_mass": self.number("hub.mass"),
            "tip_mass": self.number("beam.tip_mass"),
            "tip_inertia": self.number("beam.tip_inertia"),
            "gravity": self.text("beam.gravity"),
            "point_masses": tuple(PointMass(height, mass) for height, mass in masses if mass > 0.0),
            "clamp_stiffness": self.number("beam.clamp_stiffness") or float("inf"),
            "damping": Damping(
                ratios=self.numbers("beam.damping_ratios"),
                viscous=self.number("beam.viscous_damping"),
                air=self.number("beam.air_damping"),
                internal=self.number("beam.internal_damping"),
            ),
        }
        section = BeamParameters.from_section(
            length=self.number("beam.length"),
            width=self.number("beam.width"),
            thickness=self.number("beam.thickness"),
            density=self.number("beam.density"),
            youngs_modulus=self.number("beam.youngs_modulus"),
            **common,
        )
        rigidity = self.number("beam.flexural_rigidity") or section.flexural_rigidity
        mass_per_length = self.number("beam.mass_per_length") or section.mass_per_length
        return BeamParameters(
            length=section.length, flexural_rigidity=rigidity, mass_per_length=mass_per_length, **common
        )

    def beam_model(self) -> BeamModel:
        """The Galerkin model with the rig's number of modes."""
        from beam_model import BeamModel

        return BeamModel(self.beam_parameters(), n_modes=int(self.number("beam.modes")))

    def nonlinear_terms(self) -> NonlinearTerms | None:
        """Air drag and large deflections, where a realistic simulation is wanted."""
        if not self.values["simulation.realistic"]:
            return None
        from beam_model import AirDrag, NonlinearTerms

        return NonlinearTerms(self.beam_model(), AirDrag(self.number("beam.width")))

    def hub_parameters(self, **simulated: Any) -> HubParameters:
        """The axis and its controller.

        Parameters
        ----------
        **simulated -- what only a simulated or emulated device has, such as ``clock_drift_ppm``
        """
        from beam_ros.hub.parameters import HubParameters

        return HubParameters(
            travel=self.number("hub.travel"),
            max_speed=self.number("hub.max_speed"),
            max_acceleration=self.number("hub.max_acceleration"),
            max_effort=self.number("hub.max_effort"),
            encoder_resolution=self.number("hub.encoder_resolution"),
            command_mode=self.text("hub.command_mode"),  # type: ignore[arg-type]
            period_ns=round(self.number("hub.period") * 1e9),
            watchdog_s=self.number("hub.watchdog"),
            homing_speed=self.number("hub.homing_speed"),
            serial_port=self.text("serial.port"),
            serial_baud=int(self.number("serial.baud")),
            **simulated,
        )

    def camera_parameters(self) -> CameraParameters:
        """The camera and what it sees."""
        from beam_ros.vision.parameters import CameraParameters

        sign = 1.0 if self.text("tracker.polarity") == "bright" else -1.0
        return CameraParameters(
            width=int(self.number("camera.width")),
            height=int(self.number("camera.height")),
            rate_hz=self.number("camera.rate"),
            exposure_s=self.number("camera.exposure"),
            readout_s=self.number("camera.readout"),
            pixels_per_metre=self.number("camera.pixels_per_metre"),
            origin_px=(self.number("camera.origin_u"), self.number("camera.origin_v")),
            flip=bool(self.values["camera.is_mirrored"]),
            marker_diameter_m=self.number("markers.diameter"),
            contrast=sign * self.number("camera.contrast"),
            background=self.number("camera.background"),
            blur_px=self.number("camera.blur"),
            noise_grey=self.number("camera.noise"),
            stamp=self.text("camera.stamp"),  # type: ignore[arg-type]
            latency_s=self.number("camera.latency"),
        )

    def tracker_parameters(self) -> TrackerParameters:
        """What the tracker expects to see."""
        from beam_ros.vision.parameters import TrackerParameters

        camera = self.camera_parameters()
        return TrackerParameters(
            marker_diameter_px=camera.marker_diameter_px,
            polarity=self.text("tracker.polarity"),  # type: ignore[arg-type]
            expected_rows_px=tuple(float(row) for row in camera.rows(self.numbers("markers.heights"))),
            refinement=self.text("tracker.refinement"),  # type: ignore[arg-type]
            sigma_floor_px=max(self.number("tracker.sigma_floor"), TrackerParameters.sigma_floor_px),
            min_contrast_grey=self.number("tracker.min_contrast"),
        )

    def device_settings(self) -> DeviceSettings:
        """What is asked of the camera that the tracker reads itself.

        Raises
        ------
        ParameterFileError
            The pixel format is none.
        """
        from beam_ros.vision.camera.capture import DeviceSettings

        pixel_format = self.text("tracker.device_format")
        if pixel_format and not (pixel_format.isascii() and len(pixel_format) == 4):
            raise ParameterFileError(
                f"tracker.device_format is {pixel_format!r}: expected four characters such as GREY or MJPG, or "
                "nothing; `v4l2-ctl --list-formats` shows what the camera gives"
            )
        return DeviceSettings(
            self.text("tracker.device"),
            int(self.number("camera.width")),
            int(self.number("camera.height")),
            self.number("camera.rate"),
            pixel_format,
            self.number("camera.exposure") if self.values["tracker.sets_exposure"] else None,
        )
