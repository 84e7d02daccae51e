"""Mechanisms for simulators: masses, springs, friction, and the outputs, as MuJoCo understands them."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from beam_ident import InputSignal
from beam_ros.rig.rig import Rig
from tests.beam_ros.model_files.models import GAINS, OMEGAS, RESIDUES, ZETAS, modal, request_of, written

AXIS = {
    "simulation.servo_frequency": 50.0,
    "simulation.friction_coulomb": 0.7,
    "simulation.friction_viscous": 1.5,
}


def numbers(element: ElementTree.Element, *names: str) -> list[float]:
    return [float(element.get(name, "nan")) for name in names]


def test_springs_dampers_and_friction_stand_in_both_texts() -> None:
    request = request_of([modal()], "beam.xml", **AXIS)
    mjcf = ElementTree.fromstring(written("mjcf", request))
    urdf = ElementTree.fromstring(written("urdf", request))
    total = 0.0
    for k, (omega, zeta) in enumerate(zip(OMEGAS, ZETAS, strict=True), 1):
        body = next(own for own in mjcf.iter("body") if own.get("name") == f"mode_{k}")
        (mass,) = numbers(body.find("inertial"), "mass")
        total += mass
        spring, damper = numbers(body.find("joint"), "stiffness", "damping")
        assert spring == pytest.approx(mass * omega**2, rel=1e-14)
        assert damper == pytest.approx(2 * zeta * omega * mass, rel=1e-14)
        link = next(own for own in urdf.iter("link") if own.get("name") == f"mode_{k}")
        joint = next(own for own in urdf.iter("joint") if own.get("name") == f"mode_{k}_joint")
        assert numbers(link.find("inertial/mass"), "value") == [mass]
        assert numbers(joint.find("dynamics"), "damping") == [damper]
        gazebo = next(own for own in urdf.iter("gazebo") if own.get("reference") == f"mode_{k}_joint")
        assert float(gazebo.findtext("springStiffness")) == spring
    hub = next(own for own in mjcf.iter("body") if own.get("name") == "hub")
    rig = Rig.from_file()
    assert total + numbers(hub.find("inertial"), "mass")[0] == pytest.approx(
        rig.beam_parameters().total_mass, rel=1e-12
    )
    assert numbers(hub.find("joint"), "frictionloss", "damping") == [0.7, 1.5]
    joint = next(own for own in urdf.iter("joint") if own.get("name") == "hub_joint")
    assert numbers(joint.find("dynamics"), "friction", "damping") == [0.7, 1.5]
    assert numbers(joint.find("limit"), "lower", "upper", "effort", "velocity") == [-0.05, 0.05, 20.0, 0.5]


def test_mujoco_reads_both_and_sees_the_outputs(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="loading MJCF and URDF needs mujoco")
    request = request_of([modal()], "beam.xml", **AXIS)
    model = mujoco.MjModel.from_xml_string(written("mjcf", request).decode())
    data = mujoco.MjData(model)
    data.qpos[:] = [0.01, 0.002, -0.003]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.sensordata, 0.01 * GAINS + RESIDUES @ [0.002, -0.003], rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(model.jnt_stiffness[1:] / model.body_mass[2:]), OMEGAS, rtol=1e-12)
    assert model.dof_frictionloss[0] == 0.7
    (tmp_path / "beam.urdf").write_bytes(written("urdf", request))
    robot = mujoco.MjModel.from_xml_path(str(tmp_path / "beam.urdf"))
    assert robot.njnt == 3
    np.testing.assert_allclose(robot.dof_damping[0], 1.5, rtol=1e-12)


@pytest.mark.slow
def test_mujoco_swings_as_our_own_simulation_does() -> None:
    mujoco = pytest.importorskip("mujoco", reason="a run of the mechanism needs mujoco")
    own = modal("force", static=False)
    model = mujoco.MjModel.from_xml_string(written("mjcf", request_of([own], "beam.xml")).decode())
    data = mujoco.MjData(model)
    step = model.opt.timestep
    n = 2000
    force = np.sin(2.0 * np.pi * 4.0 * step * np.arange(n)) ** 3
    seen = []
    for value in force:
        data.ctrl[0] = value
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        seen.append(data.sensordata.copy())
    wanted = own.simulate(InputSignal("hub", "N", (0.0, step), force, "zoh"), step * np.arange(1, n))
    # Runge and Kutta's fourth order with 40 steps in a cycle of the highest mode.
    np.testing.assert_allclose(np.array(seen)[:-1], wanted, atol=1e-3 * np.max(np.abs(wanted)))
