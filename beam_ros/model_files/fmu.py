"""A model as a functional mock-up unit, FMI 3.0: description, C source, and a binary where there is a C compiler.

The source is one file that needs nothing but a C compiler; it steps exactly under held inputs (``fmu.c``).
"""

from __future__ import annotations

import hashlib
import io
import platform
import re
import shutil
import subprocess
import tempfile
import zipfile
from importlib import resources
from pathlib import Path
from xml.sax.saxutils import quoteattr

from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import WriteRequest
from beam_ros.model_files.modelica import require_no_delay

_SOURCE = "fmu.c"
_HEADER = "model.h"
_PLATFORM = "x86_64-linux"
_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
_PATIENCE_S = 120.0
_BASE_UNITS = {"m": 'm="1"', "m/s": 'm="1" s="-1"', "m/s2": 'm="1" s="-2"', "N": 'kg="1" m="1" s="-2"'}


def fmu_file(request: WriteRequest) -> bytes:
    """Return the unit, a ZIP archive.

    Raises
    ------
    UsageError
        The file's name is no identifier of C, the model has a delay or no states, or the compiler fails.
    """
    name = request.target.stem
    if not re.fullmatch(r"[A-Za-z_]\w*", name):
        raise UsageError(
            f"--fmu {request.target}: {name!r} is no name of a model; expected letters and digits"
        )
    require_no_delay(request, "--fmu")
    if not len(request.model.transition):
        raise UsageError("--fmu: the model has no states; expected one with poles")
    source = resources.files("beam_ros.model_files").joinpath(_SOURCE).read_text(encoding="utf-8")
    header = _header(request)
    files = {
        "modelDescription.xml": _description(request, name).encode(),
        f"sources/{_SOURCE}": source.encode(),
        f"sources/{_HEADER}": header.encode(),
        "sources/buildDescription.xml": _build_description(name).encode(),
    }
    binary = _compiled(source, header)
    if binary is not None:
        files[f"binaries/{_PLATFORM}/{name}.so"] = binary
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, content in files.items():
            # Without a date, so that the same model is the same file.
            archive.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _token(request: WriteRequest) -> str:
    """Return what description and binary know each other by: the same for the same numbers."""
    digest = hashlib.sha256()
    model = request.model
    for matrix in (model.transition, model.entry, model.rows, model.through):
        digest.update(repr(matrix.shape).encode() + matrix.tobytes())
    return f"{{{digest.hexdigest()[:32]}}}"


def _header(request: WriteRequest) -> str:
    model = request.model
    lines = [
        f"/* {model.source.replace('*/', '* /')} */",
        f"#define N_STATES {len(model.transition)}",
        f"#define N_INPUTS {len(model.input_names)}",
        f"#define N_OUTPUTS {len(model.output_names)}",
        f'#define TOKEN "{_token(request)}"',
    ]
    for letter, matrix in (
        ("A", model.transition),
        ("B", model.entry),
        ("C", model.rows),
        ("D", model.through),
    ):
        rows, columns = matrix.shape
        lines.append(f"static const double {letter}[{rows}][{columns}] = {_written(matrix)};")
    return "\n".join(lines) + "\n"


def _written(matrix: FloatArray) -> str:
    return "{\n" + ",\n".join("{" + ", ".join(map(repr, row)) + "}" for row in matrix.tolist()) + "}"


def _description(request: WriteRequest, name: str) -> str:
    model = request.model
    n, n_inputs, n_outputs = len(model.transition), len(model.input_names), len(model.output_names)
    outputs, states = 1 + n_inputs, 1 + n_inputs + n_outputs
    slopes = states + n
    units = sorted({unit for unit in (model.input_unit, model.output_unit) if unit})
    abilities = f'modelIdentifier="{name}" canGetAndSetFMUState="true"'
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="3.0" modelName="{name}" instantiationToken="{_token(request)}"',
        f'  description={quoteattr(model.source)} generationTool="beam_ros" variableNamingConvention="flat">',
        f"  <ModelExchange {abilities}/>",
        f'  <CoSimulation {abilities} canHandleVariableCommunicationStepSize="true"/>',
    ]
    if units:
        own = (f'    <Unit name="{unit}"><BaseUnit {_BASE_UNITS[unit]}/></Unit>' for unit in units)
        lines += ["  <UnitDefinitions>", *own, "  </UnitDefinitions>"]
    variables = ['name="time" valueReference="0" causality="independent" variability="continuous"']
    variables += [
        f'name={quoteattr(own)} valueReference="{1 + k}" causality="input" start="0"{_unit(model.input_unit)}'
        for k, own in enumerate(model.input_names)
    ]
    variables += [
        f'name={quoteattr(own)} valueReference="{outputs + j}" causality="output"{_unit(model.output_unit)}'
        for j, own in enumerate(_distinct(model.output_names, model.input_names))
    ]
    variables += [
        f'name="x[{i + 1}]" valueReference="{states + i}" causality="local" initial="exact" start="0"'
        for i in range(n)
    ]
    variables += [
        f'name="der(x[{i + 1}])" valueReference="{slopes + i}" causality="local" derivative="{states + i}"'
        for i in range(n)
    ]
    unknown = [
        *(("Output", outputs + j) for j in range(n_outputs)),
        *(("ContinuousStateDerivative", slopes + i) for i in range(n)),
        *(("InitialUnknown", outputs + j) for j in range(n_outputs)),
        *(("InitialUnknown", slopes + i) for i in range(n)),
    ]
    lines += ["  <ModelVariables>", *(f"    <Float64 {own}/>" for own in variables), "  </ModelVariables>"]
    lines += [
        "  <ModelStructure>",
        *(f'    <{kind} valueReference="{reference}"/>' for kind, reference in unknown),
        "  </ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join(lines) + "\n"


def _unit(unit: str) -> str:
    return f' unit="{unit}"' if unit else ""


def _distinct(names: tuple[str, ...], taken: tuple[str, ...]) -> list[str]:
    """Return names that no input has, too."""
    return [f"{own} (output)" if own in (*taken, "time") else own for own in names]


def _build_description(name: str) -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="{name}">\n'
        f'    <SourceFileSet language="C99"><SourceFile name="{_SOURCE}"/></SourceFileSet>\n'
        "  </BuildConfiguration>\n"
        "</fmiBuildDescription>\n"
    )


def _compiled(source: str, header: str) -> bytes | None:
    """Return the binary for Linux on x86-64; None where this is another machine, or has no compiler."""
    compiler = shutil.which("cc")
    if compiler is None or platform.system() != "Linux" or platform.machine() != "x86_64":
        return None
    with tempfile.TemporaryDirectory() as folder:
        for name, text in ((_SOURCE, source), (_HEADER, header)):
            (Path(folder) / name).write_text(text, encoding="utf-8")
        made = Path(folder) / "model.so"
        try:
            subprocess.run(
                [compiler, *_FLAGS, _SOURCE, "-lm", "-o", str(made)],
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=_PATIENCE_S,
                check=True,
            )
        except subprocess.SubprocessError as err:
            said = (getattr(err, "stderr", "") or str(err)).strip().splitlines()
            raise UsageError(
                f"--fmu: {compiler} cannot compile the model ({said[0] if said else err}); mend the compiler"
            ) from err
        return made.read_bytes()
