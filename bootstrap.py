#!/usr/bin/env python3
"""Set the suite up in a virtual environment inside this tree, and run a command in it.

    python3 bootstrap.py [--venv .venv] [--python X] [--extras ros,test] [--constraint FILE] [-- COMMAND ...]

ROS 2 Jazzy is taken from the machine where it is sourced (the environment then sees the system's packages)
and from wheels where it is not. A stamp in the environment says what it was made from: as long as that is
true, a call does nothing but start the command. A set-up that was interrupted is made anew.

The system's Python is never touched. This file is plain Python 3.6 so that an old interpreter can still look
for a newer one, or say in one line why it cannot.
"""

import argparse
import glob
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time

ROOT = os.path.dirname(os.path.abspath(__file__))
OLDEST, NEWEST = (3, 10), (3, 13)
PREFERRED = ("3.12", "3.11", "3.10", "3.13")
OLDEST_GLIBC = (2, 28)
EXTRAS = ("rig", "ros", "dask", "compiled", "remote", "study", "test", "dev", "browser", "docs")
STAMP = "beam-setup.json"
LOG = "setup.log"
LONGEST_FIRST_LINE = 255  # that Linux reads of a script
OFFLINE = "`python3 bootstrap.py --extras none` sets up what needs no ROS (beam model, simulate, identify)"

PROBE = r"""
import json, os, platform, sys, sysconfig
def has(module):
    try:
        __import__(module)
    except Exception:
        return False
    return True
print(json.dumps({
    "path": sys.executable,
    "real_path": os.path.realpath(sys.executable),
    "version": list(sys.version_info[:3]),
    "implementation": platform.python_implementation(),
    "has_gil": not sysconfig.get_config_var("Py_GIL_DISABLED"),
    "is_64_bit": sys.maxsize > 2**32,
    "has_venv": has("venv") and has("ensurepip"),
    "system": platform.system(),
    "machine": platform.machine(),
    "libc": list(platform.libc_ver()),
}))
"""

PROBE_SOURCED_ROS = r"""
import importlib.metadata, numpy, rclpy
try:
    importlib.metadata.distribution("ros-rclpy")  # wheels are no sourced ROS 2
except importlib.metadata.PackageNotFoundError:
    print(numpy.__version__)
"""


class SetupRefusedError(Exception):
    """The set-up cannot be made here; the message is one line with its remedy."""


class Setup:
    """What one call asks for, and what the environment's stamp says about it."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.venv = os.path.join(ROOT, options.venv)
        self.python = options.python
        self.extras = parse_extras(options.extras)
        self.constraint = os.path.join(ROOT, options.constraint) if options.constraint else ""
        self.is_quiet = options.quiet
        self.is_windows = os.name == "nt"
        self.scripts = os.path.join(self.venv, "Scripts" if self.is_windows else "bin")
        self.venv_python = os.path.join(self.scripts, "python.exe" if self.is_windows else "python")

    def say(self, text: str) -> None:
        """Tell the person what happens."""
        if not self.is_quiet:
            print(text, flush=True)

    # The stamp

    def wanted(self) -> dict:
        """Part of the stamp that must be as it is now."""
        return {
            "format": 1,
            "venv": self.venv,
            "requirements": digest_of_requirements(),
            "constraint": digest_of_file(self.constraint) if self.constraint else "",
        }

    def stamp(self) -> dict:
        """What the environment was made from; empty when there is none of ours."""
        try:
            with open(os.path.join(self.venv, STAMP)) as stream:
                stamp = json.load(stream)
        except (OSError, ValueError):
            return {}
        return stamp if isinstance(stamp, dict) else {}

    def write_stamp(self, stamp: dict) -> None:
        """Replace the stamp in one step, so that an interruption leaves the old or the new one."""
        path = os.path.join(self.venv, STAMP)
        with open(path + ".new", "w") as stream:
            json.dump(stamp, stream, indent=1)
        os.replace(path + ".new", path)

    def is_ready(self) -> bool:
        """Whether the environment is what this call asks for."""
        stamp = self.stamp()
        return (
            stamp.get("is_complete") is True
            and all(stamp.get(name) == value for name, value in self.wanted().items())
            and set(self.extras) <= set(stamp["extras"])
            and (not self.python or self.python in (stamp["requested"], stamp["python"]))
            and os.path.realpath(self.venv_python) == stamp["python"]
            and os.path.exists(self.venv_python)
            and ("ros" not in self.extras or stamp["sourced"] == fingerprint_of_sourced_ros())
        )

    # The set-up

    def make(self) -> None:
        """Create the environment, or bring it up to date."""
        started = time.time()
        python, source, numpy_version = self.choose()
        old = self.stamp()
        extras = sorted(set(self.extras))
        is_usable = (
            old.get("is_complete") is True
            and old.get("venv") == self.venv
            and old.get("python") == python["real_path"]
            and os.path.exists(self.venv_python)
            and (old.get("source") == source or {old.get("source"), source} == {"none", "wheels"})
        )
        is_unchanged = is_usable and all(old.get(name) == value for name, value in self.wanted().items())
        if is_usable:
            extras = sorted(set(extras) | set(old["extras"]))
            is_unchanged = is_unchanged and extras == old["extras"]
        stamp = dict(
            self.wanted(),
            extras=extras,
            requested=self.python,
            python=python["real_path"],
            source=source,
            sourced=fingerprint_of_sourced_ros(),
            is_complete=is_unchanged,
        )
        if is_unchanged:
            self.write_stamp(stamp)
            return
        origin = {
            "wheels": "ROS 2 Jazzy from wheels",
            "system": "the sourced ROS 2 Jazzy",
            "none": "without ROS",
        }
        self.say(
            "{} {} (Python {}, {}). This is done once.".format(
                "Bringing up to date" if is_usable else "Setting up",
                shown(self.venv),
                dotted(python["version"]),
                origin[source],
            )
        )
        if not is_usable:
            self.remove_own()
            os.makedirs(self.venv, exist_ok=True)
        self.write_stamp(stamp)
        environment = self.environment(source)
        if not is_usable:
            site = ["--system-site-packages"] if source == "system" else []
            self.run(
                [python["path"], "-m", "venv", *site, self.venv], environment, "creating the environment"
            )
        self.install(environment, source, extras, numpy_version)
        stamp["is_complete"] = True
        self.write_stamp(stamp)
        self.say(f"Set up in {time.time() - started:.0f} s.")

    def choose(self) -> tuple:
        """Choose the interpreter and where ROS 2 comes from.

        Returns
        -------
        tuple -- the interpreter's answers to PROBE; "system", "wheels" or "none"; NumPy's version beside the
            sourced ROS 2 or ""
        """
        if "ros" not in self.extras:
            return find_python(self.python, is_for_wheels=False), "none", ""
        if fingerprint_of_sourced_ros():
            for path in candidates(self.python):
                info = probe(path)
                if info and not unfitness(info, is_for_wheels=False):
                    answer = ask(path, PROBE_SOURCED_ROS, is_isolated=False)
                    if answer:
                        return info, "system", answer.strip()
            self.say("The sourced ROS 2 Jazzy cannot be imported by any Python found; it is left alone.")
        elif os.environ.get("ROS_DISTRO"):
            self.say(
                "ROS 2 {} is sourced; expected jazzy. It is left alone.".format(os.environ["ROS_DISTRO"])
            )
        return find_python(self.python, is_for_wheels=True), "wheels", ""

    def remove_own(self) -> None:
        """Remove an environment that this script made; refuse to touch any other."""
        if not os.path.isdir(self.venv) or not os.listdir(self.venv):
            return
        if not self.stamp():
            raise SetupRefusedError(
                f"{self.venv} exists and was not made by this script; expected no such folder; move it away "
                "or choose another with --venv"
            )
        self.say(f"Removing what an earlier set-up left in {shown(self.venv)}.")
        shutil.rmtree(self.venv)

    def install(self, environment: dict, source: str, extras: list, numpy_version: str) -> None:
        """Let pip install the tree in place with its extras."""
        constraints = ["-c", self.constraint] if self.constraint else []
        if source == "system":
            extras = sorted(set(extras) - {"ros"} | {"rig"})
            if numpy_version.startswith("1."):  # the sourced messages were compiled against it
                path = os.path.join(self.venv, "constraints.txt")
                with open(path, "w") as stream:
                    stream.write("numpy<2\nopencv-python-headless<4.12\n")
                constraints += ["-c", path]
        pip = [self.venv_python, "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
        target = ".[{}]".format(",".join(extras)) if extras else "."
        self.run(
            [*pip, "--progress-bar", "off", "-e", target, *constraints],
            environment,
            "asking the package index",
        )
        self.hold_signals_back()

    def hold_signals_back(self) -> None:
        """Let the suite's commands start with SIGINT and SIGTERM blocked, which they let in once they can take them.

        Python has its own handler long before a script's first line: a Ctrl-C in the first tenth of a second would
        end in a traceback of the interpreter's start.
        """
        if self.is_windows or "'" in self.venv_python:
            return
        words = ["/usr/bin/env", "-S", "--block-signal=INT --block-signal=TERM"]
        line = "#!{} '{}'\n".format(" ".join(words), self.venv_python).encode()
        if len(line) > LONGEST_FIRST_LINE or subprocess.call([*words, "true"], stderr=subprocess.DEVNULL):
            return  # or an env older than 2019
        for path in filter(os.path.isfile, glob.glob(os.path.join(glob.escape(self.scripts), "*"))):
            with open(path, "rb") as stream:
                script = stream.read(4096)
                if not (script.startswith(b"#!") and b"from beam_ros.process.executables import" in script):
                    continue
                body = script[script.index(b"\n") + 1 :] + stream.read()
            with open(path, "wb") as stream:
                stream.write(line + body)

    def run(self, command: list, environment: dict, activity: str) -> None:
        """Run a step with its output in the log and its progress on the terminal."""
        log = os.path.join(self.venv, LOG)
        with open(log, "ab") as stream:
            process = subprocess.Popen(
                command,
                cwd=ROOT,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            reader = LogReader(process.stdout, stream, activity)
            try:
                reader.start()
                self.watch(process, reader)
            finally:
                if process.poll() is None:
                    end_with_children(process)
                process.wait()
                reader.join()
        if process.returncode != 0:
            raise SetupRefusedError(boil_down(reader.lines, command, shown(log)))

    def watch(self, process: subprocess.Popen, reader: "LogReader") -> None:
        """Show what the step is at: one moving line on a terminal, a line every 5 s elsewhere."""
        is_terminal = sys.stdout.isatty()
        started = told = time.time()
        while process.poll() is None:
            time.sleep(0.1)
            now = time.time()
            if self.is_quiet or now - told < (0.2 if is_terminal else 5.0):
                continue
            told = now
            line = f"  {now - started:3.0f} s  {reader.activity}"
            if is_terminal:
                sys.stdout.write("\r" + line[:78].ljust(78))
                sys.stdout.flush()
            else:
                print(line, flush=True)
        if is_terminal and not self.is_quiet:
            sys.stdout.write("\r" + " " * 78 + "\r")
            sys.stdout.flush()

    # The command

    def environment(self, source: str) -> dict:
        """Environment for pip and for the command, with the virtual environment first."""
        environment = dict(os.environ)
        if source == "wheels":
            environment = without_foreign_ros(environment, self.venv)
        for name in ("PYTHONHOME", "PIP_TARGET", "PIP_PREFIX", "PIP_USER", "__PYVENV_LAUNCHER__"):
            environment.pop(name, None)
        environment["VIRTUAL_ENV"] = self.venv
        environment["PATH"] = os.pathsep.join([self.scripts, environment.get("PATH", os.defpath)])
        return environment

    def start(self, command: list) -> int:
        """Become the command."""
        environment = self.environment(self.stamp()["source"])
        path = shutil.which(command[0], path=environment["PATH"])
        if not path:
            raise SetupRefusedError(
                f"no command {command[0]!r} in {self.scripts} or on PATH; expected for instance `beam demo`"
            )
        if self.is_windows:
            return subprocess.call([path, *command[1:]], env=environment)
        sys.stdout.flush()
        os.execve(path, [path, *command[1:]], environment)
        return 0


def end_with_children(process: subprocess.Popen) -> None:
    """End a step that leads a process group of its own, and whatever it has started."""
    if os.name == "nt":
        process.terminate()
    else:
        os.killpg(process.pid, signal.SIGTERM)


class LogReader(threading.Thread):
    """Copies a step's output to the log and remembers what it is at."""

    def __init__(self, pipe, log, activity: str) -> None:
        threading.Thread.__init__(self, daemon=True)
        self.pipe, self.log, self.activity = pipe, log, activity
        self.lines = []

    def run(self) -> None:
        """Read until the step closes its output."""
        for raw in self.pipe:
            self.log.write(raw)
            self.log.flush()
            line = raw.decode("utf-8", "replace").strip()
            self.lines.append(line)
            collecting = re.match(r"Collecting ([A-Za-z0-9_.-]+)", line)
            installing = re.match(r"Installing collected packages: (.*)", line)
            if collecting:
                self.activity = "fetching " + collecting.group(1)
            elif installing:
                self.activity = "installing {} packages".format(installing.group(1).count(",") + 1)


# Interpreters


def candidates(requested: str) -> list:
    """Return paths of interpreters worth asking, the best first."""
    if requested and not re.match(r"3\.\d+$", requested):
        path = shutil.which(requested)
        return [path] if path else []
    versions = [requested] if requested else list(PREFERRED)
    paths = [] if requested and requested != "{}.{}".format(*sys.version_info[:2]) else [sys.executable]
    pyenv = os.path.join(os.environ.get("PYENV_ROOT", os.path.expanduser("~/.pyenv")), "versions")
    installed = sorted(os.listdir(pyenv)) if os.path.isdir(pyenv) else []
    for version in versions:
        paths.append(shutil.which("python" + version))
        paths += [
            os.path.join(pyenv, name, "bin", "python")
            for name in installed
            if re.match(re.escape(version) + r"\.\d+$", name)
        ]
    if not requested and os.path.exists("/usr/bin/python3"):
        paths.append("/usr/bin/python3")
    return list(dict.fromkeys(path for path in paths if path))


def ask(path: str, question: str, is_isolated: bool = True) -> str:
    """Return what an interpreter prints for a piece of code; empty when it fails or is none."""
    try:
        return subprocess.check_output(
            [path] + (["-I"] if is_isolated else []) + ["-c", question],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=60,
        ).decode("utf-8", "replace")
    except (OSError, subprocess.SubprocessError):
        return ""


def probe(path: str) -> dict:
    """Return an interpreter's answers to PROBE; empty when it is none."""
    try:
        return json.loads(ask(path, PROBE))
    except ValueError:
        return {}


def unfitness(info: dict, is_for_wheels: bool) -> str:
    """Return why an interpreter does not do, with the remedy; empty when it does."""
    version = tuple(info["version"][:2])
    if not OLDEST <= version <= NEWEST or info["implementation"] != "CPython" or not info["has_gil"]:
        kind = info["implementation"] + ("" if info["has_gil"] else " without GIL")
        return (
            "{} is {} {}; expected CPython 3.10 to 3.13; install one (Debian, Ubuntu: sudo apt install "
            "python3 python3-venv; elsewhere pyenv or conda), or name one with --python".format(
                info["path"], kind, dotted(info["version"])
            )
        )
    if is_for_wheels:
        problem = unfitness_for_wheels(info)
        if problem:
            return problem
    if not info["has_venv"]:
        return (
            "{} has no module venv or ensurepip; expected both; run `sudo apt install python{}-venv` "
            "(Debian, Ubuntu) or name another interpreter with --python".format(info["path"], dotted(version))
        )
    return ""


def unfitness_for_wheels(info: dict) -> str:
    """Return why the wheels of ROS 2 do not run on this machine; empty when they do."""
    apt = "install ROS 2 Jazzy with apt on Ubuntu 24.04, `source /opt/ros/jazzy/setup.bash` and call again"
    expected = "expected x86-64 Linux with glibc 2.28 or newer"
    if info["system"] != "Linux":
        name = {"Darwin": "macOS"}.get(info["system"], info["system"])
        return f"there are no ROS 2 wheels for {name}; {expected}; {OFFLINE}"
    if info["machine"] not in ("x86_64", "AMD64") or not info["is_64_bit"]:
        name = info["machine"] if info["is_64_bit"] else "32-bit Python"
        return f"there are no ROS 2 wheels for {name}; {expected}; {apt}, or {OFFLINE}"
    name, version = info["libc"]
    if name != "glibc":
        return "there are no ROS 2 wheels for a system with {}; {}; {}".format(
            name if name else "musl or another libc than glibc", expected, OFFLINE
        )
    if tuple(int(part) for part in re.findall(r"\d+", version)[:2]) < OLDEST_GLIBC:
        return f"there are no ROS 2 wheels for glibc {version}; {expected}; use a newer system, or {OFFLINE}"
    return ""


def find_python(requested: str, is_for_wheels: bool) -> dict:
    """Return PROBE's answers of the first interpreter that does.

    Raises
    ------
    SetupRefusedError -- there is none; says what is wrong with the first one found
    """
    problems = []
    for path in candidates(requested):
        info = probe(path)
        if not info:
            continue
        problem = unfitness(info, is_for_wheels)
        if not problem:
            return info
        problems.append(problem)
    if problems:
        raise SetupRefusedError(problems[0])
    raise SetupRefusedError(
        "no interpreter {} was found on PATH or in pyenv; expected CPython 3.10 to 3.13; install it or name "
        "its path with --python".format(requested or "python3")
    )


# Facts


def parse_extras(text: str) -> list:
    """Return the extras asked for.

    Raises
    ------
    SetupRefusedError -- an extra that setup.py does not have
    """
    extras = [extra for extra in text.split(",") if extra not in ("", "none")]
    for extra in extras:
        if extra not in EXTRAS:
            raise SetupRefusedError(
                "unknown extra {!r}; expected some of {}, or none".format(extra, ",".join(EXTRAS))
            )
    return extras


def digest_of_file(path: str) -> str:
    """Return a digest of a file's bytes."""
    try:
        with open(path, "rb") as stream:
            return hashlib.sha256(stream.read()).hexdigest()
    except OSError as error:
        raise SetupRefusedError(
            f"{path} cannot be read ({error.strerror}); expected a file of this tree or of pip's constraints"
        ) from error


def digest_of_requirements() -> str:
    """Return a digest of what an installation in place depends on: setup.py and the names of the packages."""
    packages = sorted(
        name for name in os.listdir(ROOT) if os.path.exists(os.path.join(ROOT, name, "__init__.py"))
    )
    text = digest_of_file(os.path.join(ROOT, "setup.py")) + " ".join(packages)
    return hashlib.sha256(text.encode()).hexdigest()


def fingerprint_of_sourced_ros() -> str:
    """Return a digest of the sourced ROS 2 Jazzy; empty when none is sourced."""
    if os.environ.get("ROS_DISTRO") != "jazzy" or not os.environ.get("AMENT_PREFIX_PATH"):
        return ""
    text = "\n".join(os.environ.get(name, "") for name in ("AMENT_PREFIX_PATH", "PYTHONPATH"))
    return hashlib.sha256(text.encode()).hexdigest()


def without_foreign_ros(environment: dict, venv: str) -> dict:
    """Return the environment without what another ROS 2 has put there."""
    sys.path.insert(0, ROOT)
    from pathlib import Path

    from beam_ros.process import environment as processes

    clean = processes.without_foreign_ros(environment, prefix=Path(venv))
    clean.pop(processes.WHEELS_GUARD, None)
    return clean


def shown(path: str) -> str:
    """Return a path as short as it can be written here."""
    relative = os.path.relpath(path, os.getcwd())
    return path if relative.startswith(os.pardir) else relative


def dotted(version: "list") -> str:
    """Return a version as it is written."""
    return ".".join(str(part) for part in version)


def boil_down(lines: list, command: list, log: str) -> str:
    """Return a failed step's output as one line with its remedy."""
    text = "\n".join(lines)
    no_network = (
        r"NewConnectionError|NameResolutionError|Name or service not known|name resolution|ConnectTimeout"
        r"|Network is unreachable|Connection refused|Max retries exceeded|ReadTimeout|ProxyError|SSLError"
    )
    if re.search(r"No space left on device", text):
        return f"the disk is full; expected about 1 GB free; make room and call again; log: {log}"
    if re.search(no_network, text):
        return (
            "the package index cannot be reached; expected a network connection (or pip's settings for a "
            f"mirror or a proxy); check it and call again; log: {log}"
        )
    errors = [line for line in lines if line.startswith(("ERROR:", "Error:"))] or [
        line for line in lines if line
    ]
    reason = re.sub(r"https?://\S+", "the index", errors[0]) if errors else "no output"
    step = " ".join(command[1:4])
    return f"`{step}` failed: {reason[:300]}; expected it to end with status 0; log: {log}"


# Entry


def parse(arguments: list) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="bootstrap.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--venv", default=".venv", help="folder of the environment, seen from this tree")
    parser.add_argument(
        "--python", default="", metavar="X", help="interpreter: a path, a name or a version like 3.12"
    )
    parser.add_argument(
        "--extras", default="ros", help="some of {}, or none (default: ros)".format(",".join(EXTRAS))
    )
    parser.add_argument("--constraint", default="", metavar="FILE", help="versions for pip to hold to")
    parser.add_argument("--quiet", action="store_true", help="say nothing but refusals")
    parser.add_argument(
        "--print-python", action="store_true", help="print the interpreter's path and do nothing"
    )
    split = arguments.index("--") if "--" in arguments else len(arguments)
    options = parser.parse_args(arguments[:split])
    options.command = arguments[split + 1 :]
    return options


def bootstrap(arguments: list) -> int:
    """Set up what the arguments ask for and start the command."""
    options = parse(arguments)
    if options.print_python:
        print(find_python(options.python, is_for_wheels=False)["path"])
        return 0
    setup = Setup(options)
    if sys.version_info < OLDEST:
        python = setup.venv_python if setup.is_ready() else setup.choose()[0]["path"]
        os.execv(python, [python, os.path.abspath(__file__), *arguments])
    if not setup.is_ready():
        with locked_tree():
            if not setup.is_ready():
                setup.make()
    if options.command:
        return setup.start(options.command)
    setup.say("Ready: {}".format(shown(os.path.join(setup.scripts, "beam"))))
    return 0


class locked_tree:  # noqa: N801 - reads as a statement
    """Keep a second call from setting up the same tree at the same time."""

    def __enter__(self) -> None:
        self.descriptor = -1
        try:
            import fcntl
        except ImportError:  # Windows has none
            return
        self.descriptor = os.open(ROOT, os.O_RDONLY)
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("Waiting for another set-up of this tree to end.", file=sys.stderr, flush=True)
            fcntl.flock(self.descriptor, fcntl.LOCK_EX)

    def __exit__(self, *_error: object) -> None:
        if self.descriptor >= 0:
            os.close(self.descriptor)


def main() -> int:
    """Turn what cannot be into one line and status 2."""

    def interrupt(_signal: int, _frame: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    try:
        return bootstrap(sys.argv[1:])
    except SetupRefusedError as refusal:
        print(f"bootstrap: {refusal}", file=sys.stderr)
    except OSError as error:
        print(
            "bootstrap: {} ({}); expected a folder that can be written; check rights and disk space".format(
                error.filename or "the set-up", error.strerror
            ),
            file=sys.stderr,
        )
    except KeyboardInterrupt:
        print("bootstrap: interrupted; the next call makes the set-up anew", file=sys.stderr)
        return 130
    return 2


if __name__ == "__main__":
    sys.exit(main())
