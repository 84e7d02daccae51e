"""What pip is set to goes for uv, what uv cannot do pip does, and a failed step is one line."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from beam_ros.errors import InstallationError
from beam_ros.process.installation import Installation, boiled_down, settings_for_uv, uv_cache

PYTHON_WITH_PIP = """#!/bin/sh
echo "$*" >> calls
case "$*" in
  *"pip config list"*) cat settings;;
  *uv*) echo "ERROR: {failure}"; [ -z "{failure}" ] && cp record bin/uv || exit 1;;
esac
"""
RECORD = """#!/bin/sh
echo "uv $*" >> calls
env | grep -E '^(UV_|ALL_PROXY|SSL_CERT)' | sort > variables
"""


@pytest.fixture
def venv(tmp_path: Path) -> Path:
    """A folder whose interpreter only notes how it is called; the tree and the environment are one."""
    (tmp_path / "bin").mkdir()
    for name, text in (("bin/python", PYTHON_WITH_PIP.format(failure="")), ("record", RECORD)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    (tmp_path / "settings").touch()
    return tmp_path


def calls_of(
    venv: Path, said: list[str], source: str = "wheels", numpy: str = "", **variables: str
) -> list[str]:
    """Install, and return the calls of pip, uv and the interpreter."""
    environment = {"PATH": os.environ["PATH"], "HOME": str(venv)} | variables
    installation = Installation(venv, venv, environment, said.append)
    installation.install(["ros", "test"], source, "held.txt", numpy)
    return (venv / "calls").read_text().splitlines()


def test_uv_installs_with_pips_settings_and_everything_is_started_once(venv: Path) -> None:
    (venv / "settings").write_text(
        "global.index-url='https://mirror.lab/simple'\n:env:.find-links='/wheels /more'\n"
    )
    calls = calls_of(venv, [])
    assert calls[2] == (
        f"uv pip install --python {venv}/bin/python --find-links /wheels --find-links /more -e .[ros,test] "
        "--constraint held.txt"
    )
    assert calls[3:] == ["-m beam_ros.process.first_start nodes"]
    assert (venv / "variables").read_text().splitlines() == [
        "UV_DEFAULT_INDEX=https://mirror.lab/simple",
        "UV_INDEX_STRATEGY=unsafe-best-match",
    ]


def test_what_is_said_to_uv_itself_counts_before_what_is_said_to_pip(venv: Path) -> None:
    (venv / "settings").write_text("global.index-url='https://mirror.lab/simple'\n")
    calls_of(venv, [], UV_DEFAULT_INDEX="https://own.lab/simple")
    assert "UV_DEFAULT_INDEX=https://own.lab/simple" in (venv / "variables").read_text()


@pytest.mark.parametrize("reason", ["a setting", "an index without uv"])
def test_pip_installs_where_uv_cannot_and_it_says_so(venv: Path, reason: str) -> None:
    if reason == "a setting":
        (venv / "settings").write_text("global.no-index='true'\n")
    else:
        failure = "No matching distribution found for uv<1,>=0.5"
        (venv / "bin" / "python").write_text(PYTHON_WITH_PIP.format(failure=failure))
    said: list[str] = []
    calls = calls_of(venv, said)
    assert calls[-2].startswith("-m pip install ")
    assert calls[-2].endswith("-e .[ros,test] --constraint held.txt")
    (line,) = [line for line in said if "pip installs" in line]
    assert ("no-index" if reason == "a setting" else "package index") in line


@pytest.mark.parametrize(("numpy", "holds"), [("1.26.4", True), ("2.1.0", False)])
def test_beside_a_sourced_ros_pip_installs_and_keeps_its_numpy(venv: Path, numpy: str, holds: bool) -> None:
    """pip sees the system's packages and uv does not; compiled messages need the NumPy that they were made with."""
    calls = calls_of(venv, [], source="system", numpy=numpy)
    assert calls[0].startswith("-m pip install ")
    assert "-e .[rig,test] --constraint held.txt" in calls[0]
    assert ("constraints.txt" in calls[0]) == holds
    assert not holds or (venv / "constraints.txt").read_text().startswith("numpy<2\n")


def test_without_a_network_nothing_else_is_tried(venv: Path) -> None:
    failure = "NewConnectionError: [Errno 111] Connection refused; No matching distribution found for uv"
    (venv / "bin" / "python").write_text(PYTHON_WITH_PIP.format(failure=failure))
    with pytest.raises(InstallationError, match=r"package index cannot be reached; expected .*setup\.log"):
        calls_of(venv, [])
    assert len((venv / "calls").read_text().splitlines()) == 2
    assert failure in (venv / "setup.log").read_text()


def test_a_home_that_cannot_be_written_needs_no_cache(venv: Path) -> None:
    (venv / "file").touch()
    calls_of(venv, [], UV_CACHE_DIR="/proc/uv")
    assert "UV_NO_CACHE=1" in (venv / "variables").read_text()
    calls_of(venv, [], XDG_CACHE_HOME=str(venv / "new" / "cache"))
    assert "UV_NO_CACHE" not in (venv / "variables").read_text()


def test_the_cache_is_where_uv_looks_for_it() -> None:
    assert uv_cache({"XDG_CACHE_HOME": "/caches"}) == Path("/caches/uv")
    assert uv_cache({"UV_CACHE_DIR": "/uv", "XDG_CACHE_HOME": "/caches"}) == Path("/uv")


def test_bytecode_is_written_for_the_first_start_even_where_it_usually_is_not(venv: Path) -> None:
    (venv / "bin" / "python").write_text("#!/bin/sh\nenv > variables\n")
    Installation(venv, venv, {"PATH": os.defpath, "PYTHONDONTWRITEBYTECODE": "1"}, print).install(
        [], "system", "", ""
    )
    assert "PYTHONDONTWRITEBYTECODE" not in (venv / "variables").read_text()


@pytest.mark.parametrize(
    ("listed", "options", "variables", "unknown"),
    [
        ("", [], {}, []),
        (
            "global.index-url='a'\ninstall.index-url='b'\n:env:.index-url='c'",
            [],
            {"UV_DEFAULT_INDEX": "c"},
            [],
        ),
        (
            "install.index-url='b'\nglobal.index-url='a'\ndownload.index-url='d'",
            [],
            {"UV_DEFAULT_INDEX": "b"},
            [],
        ),
        ("global.extra-index-url='\\na\\nb'", [], {"UV_INDEX": "\na\nb"}, []),
        ("global.trusted-host='a b'", [], {"UV_INSECURE_HOST": "a b"}, []),
        (
            "global.proxy='lab:3128'\nglobal.cert='/c'",
            [],
            {"ALL_PROXY": "lab:3128", "SSL_CERT_FILE": "/c"},
            [],
        ),
        (":env:.default-timeout='180'", [], {"UV_HTTP_TIMEOUT": "180"}, []),
        ("global.constraint='a.txt b.txt'", ["--constraint", "a.txt", "--constraint", "b.txt"], {}, []),
        ("global.disable-pip-version-check='1'\nglobal.cache-dir='/c'\nglobal.quiet='2'", [], {}, []),
        ("global.no-index='true'\nglobal.require-hashes='1'", [], {}, ["no-index", "require-hashes"]),
        ("global.index-url='a=b'", [], {"UV_DEFAULT_INDEX": "a=b"}, []),
    ],
)
def test_settings_of_pip_are_translated(
    listed: str, options: list[str], variables: dict[str, str], unknown: list[str]
) -> None:
    strategy = {"UV_INDEX_STRATEGY": "unsafe-best-match"}
    assert settings_for_uv(listed) == (options, strategy | variables, unknown)


@pytest.mark.parametrize(
    ("output", "line"),
    [
        (
            "error: Failed to fetch: `https://lab/x`\ncause: dns error\ncause: Name or service not known",
            "cannot be reached",
        ),
        ("error: Request failed after 3 retries\ncause: operation timed out", "cannot be reached"),
        (
            "error: Failed to install: scipy\ncause: failed to copy: No space left on device (os error 28)",
            "disk is full",
        ),
        ("Error: [Errno 28] No space left on device: '/x'", "disk is full"),
        ("error: Failed to initialize cache at `/x`\ncause: Permission denied (os error 13)", "of your own"),
        ("error: could not create 'beam_ros.egg-info': Read-only file system", "of your own"),
        (
            "Resolving\nerror: No solution found\ncause: there is no six==99",
            "failed: error: No solution found cause: there",
        ),
        ("Traceback\nImportError: libGL.so.1", "failed: ImportError: libGL.so.1; expected"),
        ("error: Failed: https://user:secret@lab/simple", "failed: error: Failed: the index; expected"),
        ("", "no output"),
    ],
)
def test_a_failed_step_is_one_line(output: str, line: str) -> None:
    told = boiled_down(output.splitlines(), "installing")
    assert line in told
    assert "expected" in told
    assert "\n" not in told


def test_progress_is_told_and_all_output_is_in_the_log(venv: Path) -> None:
    output = "Using Python\\n   Building beam\\nResolved 101 packages in 9 s\\n + numpy==2.4"
    (venv / "bin" / "python").write_text(f"#!/bin/sh\nprintf '{output}'\n")
    said: list[str] = []
    Installation(venv, venv, dict(os.environ), said.append).install([], "system", "", "")
    assert said == ["  installing", "  Resolved 101 packages in 9 s", *said[2:]]
    assert "+ numpy==2.4" in (venv / "setup.log").read_text()
    assert sys.executable not in (venv / "setup.log").read_text()
