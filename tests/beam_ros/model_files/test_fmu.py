"""The functional mock-up unit against our own simulation, run by FMPy and, without it, by the binary itself."""

from __future__ import annotations

import ctypes
import io
import platform
import shutil
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from beam_ident import InputSignal
from beam_ros.model_files.fmu import fmu_file
from tests.beam_ros.model_files.models import modal, request_of, two_inputs

T = 2e-3
HAS_BINARY = bool(shutil.which("cc")) and (platform.system(), platform.machine()) == ("Linux", "x86_64")
needs_binary = pytest.mark.skipif(not HAS_BINARY, reason="the binary needs a C compiler on Linux, x86-64")


def noise(n: int = 500) -> np.ndarray:
    return np.random.default_rng(4).standard_normal(n)


def own_simulation(structure: str, drive: np.ndarray, times: np.ndarray) -> np.ndarray:
    model = modal(structure) if structure == "force" else modal().driven_by("acceleration")
    return model.simulate(InputSignal("hub", "", (0.0, T), drive, "zoh"), times)


def test_source_and_description_are_inside_and_agree() -> None:
    content = fmu_file(request_of([modal()], "Beam.fmu"))
    assert content == fmu_file(request_of([modal()], "Beam.fmu"))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        names = set(archive.namelist())
        description = ElementTree.fromstring(archive.read("modelDescription.xml"))
        header = archive.read("sources/model.h").decode()
    assert {"sources/fmu.c", "sources/model.h", "sources/buildDescription.xml"} <= names
    assert ("binaries/x86_64-linux/Beam.so" in names) == HAS_BINARY
    assert description.get("instantiationToken") in header
    variables = {own.get("name"): own for own in description.iter("Float64")}
    assert variables["hub"].get("causality") == "input"
    assert [own for own in variables if variables[own].get("causality") == "output"] == ["z225", "tip"]
    assert len([own for own in variables if own.startswith("der(")]) == 6
    references = [own.get("valueReference") for own in variables.values()]
    assert references == [str(k) for k in range(len(references))]


@needs_binary
@pytest.mark.parametrize("structure", ["base_motion", "force"])
def test_the_binary_steps_as_our_own_simulation_does(tmp_path: Path, structure: str) -> None:
    with zipfile.ZipFile(io.BytesIO(fmu_file(request_of([modal(structure)], "Beam.fmu")))) as archive:
        archive.extractall(tmp_path)
        token = ElementTree.fromstring(archive.read("modelDescription.xml")).get("instantiationToken")
    library = ctypes.CDLL(str(tmp_path / "binaries/x86_64-linux/Beam.so"))
    library.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
    library.fmi3DoStep.argtypes = [
        ctypes.c_void_p,
        ctypes.c_double,
        ctypes.c_double,
        ctypes.c_bool,
        *[ctypes.c_void_p] * 4,
    ]
    library.fmi3FreeInstance.argtypes = [ctypes.c_void_p]
    nothing = (None, False, False, False, False, None, ctypes.c_size_t(0), None, None, None)
    assert library.fmi3InstantiateCoSimulation(b"a", b"{another}", *nothing) is None
    assert token is not None
    unit = ctypes.c_void_p(library.fmi3InstantiateCoSimulation(b"a", token.encode(), *nothing))
    one, two = ctypes.c_size_t(1), ctypes.c_size_t(2)
    drive_at, seen_at = (ctypes.c_uint32 * 1)(1), (ctypes.c_uint32 * 2)(2, 3)
    flags, last = (ctypes.c_bool * 3)(), ctypes.c_double()
    drive, seen = noise(), []
    for k, value in enumerate(drive):
        held = (ctypes.c_double * 1)(value)
        assert library.fmi3SetFloat64(unit, drive_at, one, held, one) == 0
        # Steps of two lengths: the matrices of each are exact.
        for part in (0.25, 0.75):
            places = [ctypes.byref(flags, own) for own in range(3)]
            assert library.fmi3DoStep(unit, k * T, part * T, True, *places, ctypes.byref(last)) == 0
        own = (ctypes.c_double * 2)()
        assert library.fmi3GetFloat64(unit, seen_at, two, own, two) == 0
        seen.append(list(own))
    library.fmi3FreeInstance(unit)
    # What the input does at once is still that of the value that was held.
    wanted = own_simulation(structure, drive, T * np.arange(1, len(drive)))
    through = request_of([modal(structure)]).model.through[:, 0]
    wanted = wanted - np.diff(drive)[:, None] * through
    np.testing.assert_allclose(seen[:-1], wanted, rtol=0.0, atol=1e-9 * np.max(np.abs(wanted)))


@needs_binary
@pytest.mark.slow
@pytest.mark.parametrize("structure", ["base_motion", "force"])
def test_fmpy_finds_no_fault_and_simulates_the_same(tmp_path: Path, structure: str) -> None:
    fmpy = pytest.importorskip("fmpy", reason="the run by another importer needs FMPy")
    from fmpy.validation import validate_fmu

    path = tmp_path / "Beam.fmu"
    request = request_of([modal(structure)], "Beam.fmu")
    path.write_bytes(fmu_file(request))
    assert validate_fmu(str(path)) == []
    times, drive = T * np.arange(500), noise()
    signal = np.array(list(zip(times, drive, strict=True)), dtype=[("time", float), ("hub", float)])
    found = fmpy.simulate_fmu(
        str(path), stop_time=times[-1], fmi_type="CoSimulation", step_size=T, output_interval=T, input=signal
    )
    seen = np.stack([found["z225"], found["tip"]], axis=1)[1:-1]
    wanted = (
        own_simulation(structure, drive, times[1:-1])
        - np.diff(drive)[:-1, None] * request.model.through[:, 0]
    )
    np.testing.assert_allclose(seen, wanted, rtol=0.0, atol=1e-9 * np.max(np.abs(wanted)))
    # Model exchange, by FMPy's solver, after a step: between its steps FMPy holds the inputs.
    found = fmpy.simulate_fmu(
        str(path),
        stop_time=times[-1],
        fmi_type="ModelExchange",
        output_interval=T,
        start_values={"hub": 1.0},
        relative_tolerance=1e-10,
    )
    wanted = own_simulation(structure, np.ones(500), times)
    seen = np.stack([found["z225"], found["tip"]], axis=1)
    np.testing.assert_allclose(seen, wanted, rtol=0.0, atol=1e-6 * np.max(np.abs(wanted)))


@needs_binary
def test_every_function_of_the_standard_is_exported(tmp_path: Path) -> None:
    with zipfile.ZipFile(io.BytesIO(fmu_file(request_of([two_inputs()], "Beam.fmu")))) as archive:
        archive.extractall(tmp_path)
    library = ctypes.CDLL(str(tmp_path / "binaries/x86_64-linux/Beam.so"))
    whole = [f"{sign}Int{size}" for sign in ("", "U") for size in (8, 16, 32, 64)]
    kinds = ["Float32", "Float64", *whole, "Boolean", "String", "Binary", "Clock"]
    names = [f"{word}{kind}" for word in ("Get", "Set") for kind in kinds]
    names += ["GetVersion", "DoStep", "EnterEventMode", "GetFMUState", "SerializeFMUState"]
    names += ["GetDirectionalDerivative", "ActivateModelPartition", "GetNumberOfVariableDependencies"]
    for name in names:
        assert hasattr(library, f"fmi3{name}")
    library.fmi3GetVersion.restype = ctypes.c_char_p
    assert library.fmi3GetVersion() == b"3.0"
