"""Axis and beam as a mechanism: every mode a mass that slides on a spring, for simulators of rigid bodies.

A mass m on the hub, held by a spring m omega^2 and a damper 2 zeta omega m, moves against it by q with

    q'' + 2 zeta omega q' + omega^2 q = -alpha''

which is a mode under a moved base; a marker then is at ``c alpha + sum_i r_i q_i``. With the effective masses of the
rig's modes the hub feels the reaction of the beam, too. Under a force the modes stand beside each other, of mass 1.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np

from beam_ident import ModalModel
from beam_ident.modal.structure import ModalStructure
from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import WriteRequest
from beam_ros.rig.rig import Rig

_STEPS_A_CYCLE = 40.0  # of the highest mode
_INERTIA = 1e-6  # kg m^2: nothing turns, and no simulator takes 0


@dataclass(frozen=True)
class _Slider:
    """A mass on a slide along x: the hub, or a mode."""

    name: str
    mass: float
    stiffness: float = 0.0
    damping: float = 0.0


def mjcf_file(request: WriteRequest) -> bytes:
    """Return a model of MuJoCo that can be loaded as it is, with a sensor for every output.

    Raises
    ------
    UsageError
        It is no modal model, or one of several inputs.
    """
    model = _modal_model(request, "--mjcf")
    structure = ModalStructure(model.structure)
    rig, hub_is_moved = request.rig, structure.is_motion
    modes = _modes(model, rig, hub_is_moved)
    hub = _hub(rig, modes) if hub_is_moved else _Slider("body", 1.0)
    has_hub = hub_is_moved or structure.kind != "receptance"
    half = 0.5 * rig.hub.travel
    step = 1.0 / (_STEPS_A_CYCLE * float(model.frequencies_hz[-1])) if model.n_modes else 1e-3
    axis_says = (
        f' limited="true" range="{-half!r} {half!r}" damping="{hub.damping!r}"'
        f' frictionloss="{rig.simulation.friction_coulomb!r}"'
    )
    lines = [
        f"<mujoco model={quoteattr(request.target.stem)}>",
        *(f"  <!-- {line} -->" for line in _remarks(request, model)),
        f'  <option timestep="{step!r}" integrator="RK4"/>',
        "  <worldbody>",
    ]
    if hub_is_moved:
        lines += [
            *_body(hub, axis_says, 4)[:-1],
            *(line for own in modes for line in _body(own, "", 6)),
            "    </body>",
        ]
    else:
        sliders = [hub, *modes] if has_hub else modes
        lines += [line for own in sliders for line in _body(own, "", 4)]
    lines += ["  </worldbody>", "  <tendon>"]
    for output, gain, residues in zip(model.output_names, model.gains, model.residues, strict=True):
        shares = [(hub.name, gain)] if has_hub else []
        lines += _tendon(output, [*shares, *((own.name, r) for own, r in zip(modes, residues, strict=True))])
    if not hub_is_moved:
        lines += _tendon(model.input_name, [(own.name, 1.0) for own in ([hub, *modes] if has_hub else modes)])
    lines += ["  </tendon>", "  <actuator>"]
    name = quoteattr(f"{model.input_name} force" if hub_is_moved else model.input_name)
    effort = rig.hub.max_effort
    if hub_is_moved:
        lines.append(
            f'    <motor name={name} joint="hub" ctrllimited="true" ctrlrange="{-effort!r} {effort!r}"/>'
        )
    else:
        lines.append(f"    <motor name={name} tendon={quoteattr(model.input_name)}/>")
    lines += ["  </actuator>", "  <sensor>"]
    lines += [f"    <tendonpos name={quoteattr(own)} tendon={quoteattr(own)}/>" for own in model.output_names]
    lines += ["  </sensor>", "</mujoco>"]
    return ("\n".join(lines) + "\n").encode()


def urdf_file(request: WriteRequest) -> bytes:
    """Return a robot of links and joints: the axis with its friction and limits, and a link for every mode.

    Raises
    ------
    UsageError
        It is no modal model of a moved base.

    Notes
    -----
    URDF has no springs; Gazebo's own element for them says the stiffness.
    """
    model = _modal_model(request, "--urdf")
    if not ModalStructure(model.structure).is_motion:
        raise UsageError(
            f"--urdf: the model is driven by a force ({model.structure}), and its modes are those of the free hub; "
            "expected one of a moved base. Write --mjcf, or identify from the hub's position"
        )
    rig = request.rig
    modes = _modes(model, rig, is_on_hub=True)
    hub = _hub(rig, modes)
    half, reach = 0.5 * rig.hub.travel, rig.hub.max_tip_deflection
    name = re.sub(r"\W", "_", request.target.stem)
    lines = [
        '<?xml version="1.0"?>',
        *(f"<!-- {line} -->" for line in _remarks(request, model)),
        f"<robot name={quoteattr(name)}>",
        '  <link name="rail"/>',
        *_link(hub),
        *_joint("rail", hub, rig.simulation.friction_coulomb, (half, rig.hub.max_effort, rig.hub.max_speed)),
    ]
    for own in modes:
        speed = reach * math.sqrt(own.stiffness / own.mass)
        lines += _link(own)
        lines += _joint("hub", own, 0.0, (reach, 0.0, speed))
        lines += [
            f'  <gazebo reference="{own.name}_joint">',
            f"    <springReference>0</springReference><springStiffness>{own.stiffness!r}</springStiffness>",
            "  </gazebo>",
        ]
    return ("\n".join([*lines, "</robot>"]) + "\n").encode()


def _modal_model(request: WriteRequest, flag: str) -> ModalModel:
    model = request.model.models[0]
    if len(request.model.models) != 1 or not isinstance(model, ModalModel) or model.further_inputs:
        raise UsageError(
            f"{flag}: {request.model.source} holds no modal model of one input; expected one of `beam identify "
            "--estimator modal`"
        )
    return model


def _modes(model: ModalModel, rig: Rig, is_on_hub: bool) -> list[_Slider]:
    """Return a slider for every mode; on the hub with the share of the beam's mass that the rig's mode carries."""
    masses = np.ones(model.n_modes)
    if is_on_hub:
        shares = rig.beam_model().effective_mass_fractions
        masses = _beam_mass(rig) * _padded(shares, model.n_modes)
    return [
        _Slider(f"mode_{k}", m, m * w**2, 2.0 * z * w * m)
        for k, (w, z, m) in enumerate(
            zip(
                model.natural_frequencies.tolist(),
                model.damping_ratios.tolist(),
                masses.tolist(),
                strict=True,
            ),
            1,
        )
    ]


def _padded(shares: FloatArray, n: int) -> FloatArray:
    """Return the shares of n modes; modes beyond the rig's carry as little as its last."""
    return np.concatenate([shares[:n], np.full(max(n - len(shares), 0), shares[-1])])


def _beam_mass(rig: Rig) -> float:
    parameters = rig.beam_parameters()
    return float(parameters.total_mass - parameters.hub_mass)


def _hub(rig: Rig, modes: list[_Slider]) -> _Slider:
    """Return the hub with that part of the beam which no mode carries."""
    rest = max(_beam_mass(rig) - sum(own.mass for own in modes), 0.0)
    return _Slider("hub", float(rig.hub.mass) + rest, damping=float(rig.simulation.friction_viscous))


def _remarks(request: WriteRequest, model: ModalModel) -> list[str]:
    said = [
        request.model.source.replace("--", "- -"),
        f"Outputs: c alpha + sum r q in metres; {', '.join(model.output_names)}".replace("--", "- -"),
    ]
    if np.any(model.residual_terms):
        said.append("Static terms of the modes left out are not in it")
    return said


def _body(own: _Slider, more: str, indent: int) -> list[str]:
    blank = " " * indent
    spring = "" if more else f' stiffness="{own.stiffness!r}" damping="{own.damping!r}"'
    return [
        f'{blank}<body name="{own.name}">',
        f'{blank}  <joint name="{own.name}" type="slide" axis="1 0 0"{more}{spring}/>',
        f'{blank}  <inertial pos="0 0 0" mass="{own.mass!r}" diaginertia="{_INERTIA} {_INERTIA} {_INERTIA}"/>',
        f"{blank}</body>",
    ]


def _tendon(name: str, shares: list[tuple[str, float]]) -> list[str]:
    return [
        f"    <fixed name={quoteattr(name)}>",
        *(f'      <joint joint="{joint}" coef="{float(share)!r}"/>' for joint, share in shares),
        "    </fixed>",
    ]


def _link(own: _Slider) -> list[str]:
    return [
        f'  <link name="{own.name}">',
        "    <inertial>",
        f'      <mass value="{own.mass!r}"/>',
        f'      <inertia ixx="{_INERTIA}" ixy="0" ixz="0" iyy="{_INERTIA}" iyz="0" izz="{_INERTIA}"/>',
        "    </inertial>",
        "  </link>",
    ]


def _joint(parent: str, own: _Slider, friction: float, limits: tuple[float, float, float]) -> list[str]:
    reach, effort, speed = limits
    return [
        f'  <joint name="{own.name}_joint" type="prismatic">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{own.name}"/>',
        '    <axis xyz="1 0 0"/>',
        f'    <limit lower="{-reach!r}" upper="{reach!r}" effort="{effort!r}" velocity="{speed!r}"/>',
        f'    <dynamics damping="{own.damping!r}" friction="{friction!r}"/>',
        "  </joint>",
    ]
