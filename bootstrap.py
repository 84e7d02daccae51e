#!/usr/bin/env python3
"""Set the suite up in a virtual environment inside this tree, and run a command in it.

    python3 bootstrap.py [--venv .venv] [--python X] [--extras ros,test] [--constraint FILE] [-- COMMAND ...]

ROS 2 Jazzy is taken from the machine where it is sourced (the environment then sees the system's packages) and
from wheels where it is not. A stamp in the environment says what it was made from: as long as that is true, a call
does nothing but start the command. A set-up that was interrupted is made anew. The system's Python is never touched.

This file chooses the interpreter and where ROS 2 comes from; `stamped_environment.py` and `installation.py` of
`beam_ros/process` do the rest. It is plain Python 3.6, so that an old interpreter can look for a newer one; each
says itself, in one line, why it does not fit.
"""

import argparse
import errno
import glob
import importlib.util
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import sysconfig

ROOT = os.path.dirname(os.path.abspath(__file__))
OLDEST, NEWEST, OLDEST_GLIBC = (3, 10), (3, 14), (2, 28)
PREFERRED = ("3.12", "3.11", "3.10", "3.13", "3.14")
PLACES = ("~/.pyenv/versions/{0}.*/bin/python", "~/.local/share/uv/python/cpython-{0}.*/bin/python{0}")
EXTRAS = (
    "rig",
    "view",
    "ros",
    "dask",
    "compiled",
    "remote",
    "study",
    "files",
    "test",
    "dev",
    "browser",
    "docs",
)

EXPECTED = (
    "expected CPython {}.{} to {}.{}; name one with --python, or install one beside it (python3.12 and "
    "python3.12-venv where your system has them, `pyenv install 3.12`, or `uv python install 3.12`) and call with "
    "--python 3.12"
).format(*OLDEST, *NEWEST)
NO_WHEELS = (
    "there are no ROS 2 wheels for {}; expected x86-64 Linux with glibc 2.28 or newer; install ROS 2 Jazzy with apt "
    "on Ubuntu 24.04, `source /opt/ros/jazzy/setup.bash` and call again, or set up what needs no ROS (beam model, "
    "simulate, identify): `python3 bootstrap.py --extras none`"
)
SOURCED_ROS = r"""
import importlib.metadata, numpy, rclpy
try:
    importlib.metadata.distribution("ros-rclpy")  # wheels are no sourced ROS 2
except importlib.metadata.PackageNotFoundError:
    print(numpy.__version__)
"""


class SetupRefusedError(OSError):
    """The set-up cannot be made here; the message is one line with its remedy."""


def sourced_ros() -> str:
    """Return what tells one sourced ROS 2 Jazzy from another; empty when none is sourced."""
    if os.environ.get("ROS_DISTRO") != "jazzy" or not os.environ.get("AMENT_PREFIX_PATH"):
        return ""
    return "\n".join(os.environ.get(name, "") for name in ("AMENT_PREFIX_PATH", "PYTHONPATH"))


def choose(requested: str, wants_ros: bool, say) -> tuple:
    """Choose the interpreter and where ROS 2 comes from.

    Returns
    -------
    tuple -- path of the interpreter; "system", "wheels" or "none"; NumPy's version beside a sourced ROS 2 or ""
    """
    if not wants_ros:
        return find_python(requested, is_for_wheels=False), "none", ""
    if sourced_ros():
        for path in candidates(requested):
            python, problem = judged(path, is_for_wheels=False)
            numpy_version = "" if problem else ask([path, "-c", SOURCED_ROS]).strip()
            if numpy_version:
                return python, "system", numpy_version
        say("The sourced ROS 2 Jazzy cannot be imported by any Python found; it is left alone.")
    elif os.environ.get("ROS_DISTRO"):
        say("ROS 2 {} is sourced; expected jazzy. It is left alone.".format(os.environ["ROS_DISTRO"]))
    return find_python(requested, is_for_wheels=True), "wheels", ""


def candidates(requested: str) -> list:
    """Return paths of interpreters worth asking, the best first."""
    if requested and not re.match(r"3\.\d+$", requested):
        return list(filter(None, [shutil.which(requested)]))
    paths = [sys.executable] if requested in ("", "{}.{}".format(*sys.version_info[:2])) else []
    for version in [requested] if requested else PREFERRED:
        paths.append(shutil.which("python" + version))
        for place in PLACES:
            paths += sorted(glob.glob(os.path.expanduser(place.format(version))))
    return list(dict.fromkeys(filter(None, paths + ([] if requested else ["/usr/bin/python3"]))))


def ask(command: list) -> str:
    """Return what a command prints; empty when it fails or is none."""
    quiet = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "timeout": 60}
    try:
        return subprocess.check_output(command, **quiet).decode("utf-8", "replace")
    except (OSError, subprocess.SubprocessError):
        return ""


def judged(path: str, is_for_wheels: bool) -> tuple:
    """Return an interpreter's real path, and what it says to be wrong with itself or ""."""
    answer = ask([path, os.path.abspath(__file__), "--judge", str(is_for_wheels)]).splitlines()
    return tuple(answer) if len(answer) == 2 else (path, f"{path} does not answer as a Python; {EXPECTED}")


def find_python(requested: str, is_for_wheels: bool) -> str:
    """Return the real path of the first interpreter that fits.

    Raises
    ------
    SetupRefusedError -- there is none; says what is wrong with the first one found
    """
    problems = []
    for path in candidates(requested):
        python, problem = judged(path, is_for_wheels)
        if not problem:
            return python
        problems.append(problem)
    raise SetupRefusedError([*problems, f"no interpreter {requested or 'python3'} was found; {EXPECTED}"][0])


def unfitness(is_for_wheels: bool) -> str:
    """Return why the interpreter that runs this does not do, with the remedy; empty when it does."""
    kind, version = platform.python_implementation(), platform.python_version()
    if sysconfig.get_config_var("Py_GIL_DISABLED"):
        kind += " without GIL"
    if kind != "CPython" or not OLDEST <= sys.version_info[:2] <= NEWEST:
        return f"{sys.executable} is {kind} {version}; {EXPECTED}"
    libc, libc_version = platform.libc_ver()
    wheelless = (
        (platform.system() != "Linux", platform.system().replace("Darwin", "macOS")),
        (platform.machine() not in ("x86_64", "AMD64"), platform.machine()),
        (sys.maxsize < 2**32, "a 32-bit Python"),
        (libc != "glibc", "a system with " + (libc or "musl or another libc than glibc")),
        (tuple(map(int, re.findall(r"\d+", libc_version)[:2])) < OLDEST_GLIBC, "glibc " + libc_version),
    )
    for is_so, place in wheelless if is_for_wheels else ():
        if is_so:
            return NO_WHEELS.format(place)
    if not all(importlib.util.find_spec(module) for module in ("venv", "ensurepip")):
        remedy = "run `sudo apt install python{}.{}-venv` (Debian, Ubuntu)".format(*sys.version_info[:2])
        return (
            f"{sys.executable} lacks venv or ensurepip; expected both; {remedy} or name another with --python"
        )
    return ""


def parse(arguments: list) -> argparse.Namespace:
    """Read the command line."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="bootstrap.py", description=__doc__, formatter_class=raw)
    add = parser.add_argument
    add("--venv", default=".venv", help="folder of the environment, seen from this tree")
    add("--python", default="", metavar="X", help="interpreter: a path, a name or a version like 3.12")
    add("--extras", default="ros", help=f"some of {','.join(EXTRAS)}, or none (default: ros)")
    add("--constraint", default="", metavar="FILE", help="versions to hold to, as pip reads them")
    add("--quiet", action="store_true", help="say nothing but refusals")
    add("--print-python", action="store_true", help="print the interpreter's path and do nothing")
    split = arguments.index("--") if "--" in arguments else len(arguments)
    options = parser.parse_args(arguments[:split])
    options.command = arguments[split + 1 :]
    options.extras = {extra for extra in options.extras.split(",") if extra not in ("", "none")}
    for extra in options.extras - set(EXTRAS):
        raise SetupRefusedError(f"unknown extra {extra!r}; expected some of {','.join(EXTRAS)}, or none")
    return options


def bootstrap(arguments: list) -> int:
    """Set up what the arguments ask for and start the command."""
    if arguments[:1] == ["--judge"]:
        print(os.path.realpath(sys.executable), unfitness(arguments[1:] == ["True"]), sep="\n")
        return 0
    options = parse(arguments)
    if options.print_python:
        print(find_python(options.python, is_for_wheels=False))
        return 0
    if sys.version_info < OLDEST:
        run_with(find_python(options.python, is_for_wheels=False), arguments)
    sys.path.insert(0, ROOT)
    from beam_ros.process.stamped_environment import StampedEnvironment

    say = (lambda _text: None) if options.quiet else (lambda text: print(text, flush=True))
    environment = StampedEnvironment(ROOT, options.venv, sourced_ros(), say)
    wanted = {"extras": options.extras, "requested": options.python, "constraint": options.constraint}
    if not environment.is_ready(**wanted):
        python, source, numpy_version = choose(options.python, "ros" in options.extras, say)
        if python != os.path.realpath(sys.executable):
            run_with(python, arguments)
        environment.make(source=source, numpy_version=numpy_version, **wanted)
    if options.command:
        return environment.start(options.command)
    say("Ready: " + os.path.join(options.venv, os.path.basename(environment.scripts), "beam"))
    return 0


def run_with(python: str, arguments: list) -> None:
    """Go on in another interpreter."""
    sys.stdout.flush()
    os.execv(python, [python, os.path.abspath(__file__), *arguments])


def main() -> int:
    """Turn what cannot be into one line and status 2."""

    def interrupt(_signal: int, _frame: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    try:
        return bootstrap(sys.argv[1:])
    except OSError as error:
        text = str(error)
        if error.errno == errno.ENOSPC:
            text = "the disk is full; expected about 1 GB free; make room and call again"
        elif error.errno is not None:
            remedy = "call as their owner, or in a clone of your own"
            text = f"{error.filename}: {error.strerror}; expected a tree and an environment of your own; {remedy}"
        print(f"bootstrap: {text}", file=sys.stderr)
    except KeyboardInterrupt:
        print("bootstrap: interrupted; the next call makes the set-up anew", file=sys.stderr)
        return 130
    return 2


if __name__ == "__main__":
    sys.exit(main())
