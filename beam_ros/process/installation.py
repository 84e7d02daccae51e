"""A virtual environment that holds this tree in place, and whatever its extras need.

The steps are those of a careful person: ``venv``, then the installer, then a first start of everything. The installer
is ``uv``, which pip brings into the environment and which gets pip's settings (an index of one's own, a proxy,
certificates, constraints). pip itself installs where uv cannot: uv does not see the packages of the system, which a
sourced ROS 2 needs; some indexes do not have it; and some settings are pip's alone.

Only the standard library is imported here: there is nothing else yet.
"""

from __future__ import annotations

import ast
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from beam_ros.errors import InstallationError

UV = "uv>=0.5,<1"
LOG = "setup.log"

_NAMES_OF_UV = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "trusted-host": "UV_INSECURE_HOST",
    "cert": "SSL_CERT_FILE",
    "client-cert": "SSL_CLIENT_CERT",
    "proxy": "ALL_PROXY",
    "timeout": "UV_HTTP_TIMEOUT",
    "default-timeout": "UV_HTTP_TIMEOUT",
    "retries": "UV_HTTP_RETRIES",
    "no-cache-dir": "UV_NO_CACHE",
    "constraint": "--constraint",
    "find-links": "--find-links",
}
"""pip's settings, and uv's variables or options of the same meaning."""

_WITHOUT_EFFECT = re.compile(
    r"disable-|no-input|progress-bar|quiet|verbose|no-color|cache-dir|root-user|break-system|require-virt|user$|log$"
)
"""Settings that change nothing about what is installed into an environment."""

_FAULTS = (
    (r"No space left|Disk quota", "the disk is full; expected about 1 GB free; make room and call again"),
    (
        r"NewConnectionError|[Nn]ame resolution|Name or service not known|error sending request|dns error|Timeout"
        r"|timed out|Network is unreachable|Connection refused|Max retries exceeded|ProxyError|SSLError",
        "the package index cannot be reached; expected a network connection (or pip's settings for a mirror or a "
        "proxy); check it and call again",
    ),
    (
        r"Permission denied|Read-only file system",
        "a file cannot be written; expected a tree and a home of your own; call as their owner, or in a clone of "
        "your own",
    ),
)
"""What a failed step has written, and what that means to a person."""

_PROGRESS = re.compile(r"(Resolved|Downloading|Prepared|Installed|Collecting|Installing) ")


class Installation:
    """The steps that make an environment, with one line of progress each and a log.

    Parameters
    ----------
    root : Path -- folder of the tree
    venv : Path -- folder of the environment; exists
    environment : mapping of str to str -- the processes' environment, without another ROS 2
    say : callable -- tells the person what happens
    """

    def __init__(
        self, root: Path, venv: Path, environment: Mapping[str, str], say: Callable[[str], None]
    ) -> None:
        self._root, self._venv, self._say = root, venv, say
        self._environment = {k: v for k, v in environment.items() if k != "PYTHONDONTWRITEBYTECODE"}
        scripts = self._venv / ("Scripts" if os.name == "nt" else "bin")
        self._python, self._uv = str(scripts / "python"), str(scripts / "uv")

    def create(self, sees_system: bool) -> None:
        """Make the environment of the interpreter that runs this.

        Raises
        ------
        InstallationError -- one line with its remedy, as from ``install``
        """
        site = ["--system-site-packages"] if sees_system else []
        self._run([sys.executable, "-m", "venv", *site, str(self._venv)], "creating the environment")

    def install(self, extras: list[str], source: str, constraint: str, numpy_version: str) -> None:
        """Install the tree in place with its extras, and start everything once.

        Parameters
        ----------
        extras : list of str -- of setup.py
        source : str -- where ROS 2 comes from: "system", "wheels" or "none"
        constraint : str -- file of versions to hold to, or ""
        numpy_version : str -- NumPy's beside a sourced ROS 2, whose messages were compiled against it; or ""
        """
        constraints = [constraint] if constraint else []
        if source == "system":
            extras = sorted(set(extras) - {"ros"} | {"rig"})
            held = self._venv / "constraints.txt"
            if numpy_version.startswith("1."):
                held.write_text("numpy<2\nopencv-python-headless<4.12\n")
            constraints += [str(held)] if held.exists() else []
        command = self._pip_install() if source == "system" else self._installer()
        command += ["-e", f".[{','.join(extras)}]" if extras else "."]
        for path in constraints:
            command += ["--constraint", path]
        self._run(command, "installing")
        nodes = [] if source == "none" else ["nodes"]
        self._run(
            [self._python, "-m", "beam_ros.process.first_start", *nodes], "starting it for the first time"
        )

    def _pip_install(self) -> list[str]:
        quiet = ["--no-input", "--disable-pip-version-check", "--progress-bar", "off"]
        return [self._python, "-m", "pip", "install", *quiet]

    def _installer(self) -> list[str]:
        """Return the command that installs packages; uv's with pip's settings, or pip's own."""
        asked = [self._python, "-m", "pip", "config", "list"]
        listed = subprocess.run(
            asked, cwd=self._root, env=self._environment, capture_output=True, text=True, check=False
        )
        options, variables, unknown = settings_for_uv(listed.stdout)
        reason = f"has no word for pip's setting {unknown[0]}" if unknown else ""
        if not reason and not self._has_brought_uv():
            reason = "is not on the package index"
        if reason:
            self._say(f"  uv {reason}: pip installs, which takes longer")
            return self._pip_install()
        if not _can_write(uv_cache(self._environment)):
            variables["UV_NO_CACHE"] = "1"
        self._environment = variables | self._environment
        return [self._uv, "pip", "install", "--python", self._python, *options]

    def _has_brought_uv(self) -> bool:
        try:
            self._run([*self._pip_install(), UV], "fetching uv")
        except InstallationError as error:
            if "No matching distribution found for uv" not in str(error):
                raise
            return False
        return True

    def _run(self, command: list[str], activity: str) -> None:
        """Run a step: all of its output goes to the log, and what it is at to the terminal."""
        self._say(f"  {activity}")
        lines = []
        with (self._venv / LOG).open("ab") as log:
            process = subprocess.Popen(
                command,
                cwd=self._root,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            assert process.stdout is not None
            try:
                for raw in process.stdout:
                    log.write(raw)
                    log.flush()
                    lines.append(raw.decode("utf-8", "replace").strip())
                    if _PROGRESS.match(lines[-1]):
                        self._say(f"  {lines[-1][:76]}")
                process.wait()
            finally:
                if process.poll() is None:
                    _end_with_children(process)
        if process.returncode != 0:
            raise InstallationError(f"{boiled_down(lines, activity)}; log: {self._venv / LOG}")


def settings_for_uv(listed: str) -> tuple[list[str], dict[str, str], list[str]]:
    """Translate pip's settings, so that a mirror or a proxy is for uv what it is for pip.

    Parameters
    ----------
    listed : str -- what ``pip config list`` prints

    Returns
    -------
    options : list of str -- for uv's command line
    variables : dict of str to str -- for uv's environment
    unknown : list of str -- settings for which uv has no word
    """
    sections: dict[str, dict[str, str]] = {"global": {}, "install": {}, ":env:": {}}  # the last one counts
    for line in listed.splitlines():
        key, _, value = line.partition("=")
        section, _, name = key.rpartition(".")
        if section in sections and not _WITHOUT_EFFECT.match(name):
            sections[section][name] = ast.literal_eval(value)
    settings = sections["global"] | sections["install"] | sections[":env:"]
    options: list[str] = []
    variables = {"UV_INDEX_STRATEGY": "unsafe-best-match"}  # as pip: the best version of all indexes
    for name, value in settings.items():
        own = _NAMES_OF_UV.get(name, "")
        if own.startswith("--"):
            options += [word for part in value.split() for word in (own, part)]
        elif own:
            variables[own] = value
    return options, variables, [name for name in settings if name not in _NAMES_OF_UV]


def uv_cache(environment: Mapping[str, str]) -> Path:
    """Return the folder in which uv keeps what it has fetched."""
    caches = environment.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(environment.get("UV_CACHE_DIR") or os.path.join(caches, "uv"))


def _can_write(folder: Path) -> bool:
    """Whether a folder can be written; it is made where there is none."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def boiled_down(lines: list[str], activity: str) -> str:
    """Return a failed step's output as one line with its remedy."""
    text = "\n".join(lines)
    for pattern, line in _FAULTS:
        if re.search(pattern, text):
            return line
    starts = [i for word in ("ERROR:", "error:") for i, line in enumerate(lines) if line.startswith(word)]
    first = next(iter(starts), len(lines) - 1)  # pip writes the cause in capitals
    reason = re.sub(r"https?://\S+", "the index", " ".join(lines[max(first, 0) :][:3])) or "no output"
    return f"{activity} failed: {reason[:300]}; expected it to end with status 0"


def _end_with_children(process: subprocess.Popen[bytes]) -> None:
    """End a step that leads a process group of its own, and whatever it has started."""
    if sys.platform == "win32":
        process.terminate()
    else:
        os.killpg(process.pid, signal.SIGTERM)
    process.wait()


@contextmanager
def alone(root: Path) -> Iterator[None]:
    """Keep a second call from setting up the same tree at the same time."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    descriptor = os.open(root, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("Waiting for another set-up of this tree to end.", file=sys.stderr, flush=True)  # noqa: T201
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
