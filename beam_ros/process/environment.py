"""The process environment of the suite: one ROS 2 per process, never two.

ROS 2 comes either from a sourced installation (apt) or from wheels inside a virtual environment. Where the
wheels are, whatever a sourced ROS 2 left in PYTHONPATH, LD_LIBRARY_PATH or AMENT_PREFIX_PATH would be loaded
before them, half of one beside half of the other. So a process that finds itself in a wheels environment
takes those variables out; because the interpreter and the dynamic linker have read two of them already, it
starts itself once more when they were set. In a sourced installation nothing is touched.

Only the standard library is imported here, and nothing else before ``enter`` has run.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path

WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Set by the wheels' own start-up code once it has put their libraries on LD_LIBRARY_PATH."""

RESTART_GUARD = "BEAM_ROS_RESTARTED"
"""Process id of a process that has started itself again; a second need would be a loop."""

ROS_VARIABLES = (
    "AMENT_PREFIX_PATH",
    "AMENT_CURRENT_PREFIX",
    "COLCON_PREFIX_PATH",
    "COLCON_CURRENT_PREFIX",
    "ROS_DISTRO",
    "ROS_VERSION",
    "ROS_PYTHON_VERSION",
    "ROS_ROOT",
    "ROS_ETC_DIR",
    "ROS_PACKAGE_PATH",
    "RMW_IMPLEMENTATION",
)
"""What a sourced ROS 2 says about itself. The user's own choices (ROS_DOMAIN_ID, discovery) are not here."""

_PACKAGE_ROOT = Path(__file__).absolute().parents[2]


def enter() -> None:
    """Make this process safe for its own ROS 2; call it before anything but the standard library is imported.

    In a wheels environment the variables of a foreign ROS 2 are removed and AMENT_PREFIX_PATH is set to the
    environment's prefix. If the interpreter was started with a foreign PYTHONPATH or LD_LIBRARY_PATH, the
    same command is executed anew without them, and this call does not return.

    Raises
    ------
    SystemExit -- status 2, when the variables are foreign again after the restart
    """
    prefix = Path(sys.prefix)
    if not has_ros_wheels(prefix):
        return
    clean = without_foreign_ros(os.environ, prefix=prefix, package_root=_PACKAGE_ROOT)
    if not _has_been_started_with(clean):
        if os.environ.get(RESTART_GUARD) == str(os.getpid()):
            sys.exit(_refuse_second_restart(clean))
        clean.pop(WHEELS_GUARD, None)
        clean[RESTART_GUARD] = str(os.getpid())
        sys.stdout.flush()
        sys.stderr.flush()
        # They wait until the new interpreter can take them (beam_ros/process/interruption.py).
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], clean)
    clean.pop(RESTART_GUARD, None)
    for name in set(os.environ) - set(clean):
        del os.environ[name]
    os.environ.update(clean)


def child_environment(extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """Environment for a process of the suite that this process starts.

    Parameters
    ----------
    extra : mapping of str to str, optional -- variables to set on top, such as a private ROS_DOMAIN_ID

    Returns
    -------
    dict of str to str -- without foreign ROS variables where ROS 2 comes from wheels; this tree is on
        PYTHONPATH only where it is not installed
    """
    prefix = Path(sys.prefix)
    environ = dict(os.environ)
    if has_ros_wheels(prefix):
        environ = without_foreign_ros(environ, prefix=prefix, package_root=_PACKAGE_ROOT)
        if not _covers_libraries(environ, prefix):
            environ.pop(WHEELS_GUARD, None)
    environ.pop(RESTART_GUARD, None)
    if not _is_installed(prefix) and str(_PACKAGE_ROOT) not in _entries(environ, "PYTHONPATH"):
        environ["PYTHONPATH"] = os.pathsep.join([str(_PACKAGE_ROOT), *_entries(environ, "PYTHONPATH")])
    environ.update(extra or {})
    return environ


def has_ros_wheels(prefix: Path) -> bool:
    """Whether ROS 2 is installed from wheels in the environment at ``prefix``."""
    return any(_site_packages(prefix).glob("ros_rclpy-*.dist-info"))


def without_foreign_ros(
    environ: Mapping[str, str], *, prefix: Path, package_root: Path | None = None
) -> dict[str, str]:
    """Return the environment for a process of the wheels environment at ``prefix``.

    Parameters
    ----------
    environ : mapping of str to str -- the environment found
    prefix : Path -- the virtual environment whose ROS 2 is the process's own
    package_root : Path, optional -- the one PYTHONPATH entry that may stay: where this very package was
        imported from (a colcon workspace), unless an rclpy lies beside it

    Returns
    -------
    dict of str to str -- a copy in which PYTHONPATH holds no other entry, LD_LIBRARY_PATH only directories of
        ``prefix`` and that of the interpreter's own library, and the variables in ROS_VARIABLES are gone;
        AMENT_PREFIX_PATH is ``prefix``
    """
    clean = {name: value for name, value in environ.items() if name not in ROS_VARIABLES}
    may_stay = package_root is not None and not (package_root / "rclpy").exists()
    python_path = [
        entry
        for entry in _entries(environ, "PYTHONPATH")
        if may_stay and os.path.realpath(entry) == os.path.realpath(str(package_root))
    ]
    library_path = [
        entry
        for entry in _entries(environ, "LD_LIBRARY_PATH")
        if _is_inside(entry, prefix) or _holds_interpreter(entry)
    ]
    for name, entries in (("PYTHONPATH", python_path), ("LD_LIBRARY_PATH", library_path)):
        clean.pop(name, None)
        if entries:
            clean[name] = os.pathsep.join(entries)
    clean["AMENT_PREFIX_PATH"] = str(prefix)
    return clean


def _has_been_started_with(clean: Mapping[str, str]) -> bool:
    """Whether interpreter and linker started from what ``clean`` says, with the wheels' libraries in reach."""
    return all(
        _entries(os.environ, name) == _entries(clean, name) for name in ("PYTHONPATH", "LD_LIBRARY_PATH")
    ) and _covers_libraries(clean, Path(sys.prefix))


def _covers_libraries(environ: Mapping[str, str], prefix: Path) -> bool:
    on_path = {os.path.realpath(entry) for entry in _entries(environ, "LD_LIBRARY_PATH")}
    return all(str(path.resolve()) in on_path for path in _site_packages(prefix).glob("ros_*.libs"))


def _is_installed(prefix: Path) -> bool:
    site = _site_packages(prefix)
    return site == _PACKAGE_ROOT or any(site.glob("beam_ros-*.dist-info"))


def _refuse_second_restart(clean: Mapping[str, str]) -> int:
    found = [
        f"{name}={os.environ[name]}"
        for name in ("PYTHONPATH", "LD_LIBRARY_PATH")
        if _entries(os.environ, name) != _entries(clean, name)
    ]
    what = ", ".join(found) or f"LD_LIBRARY_PATH lacks the libraries of {sys.prefix}"
    print(  # noqa: T201 - no logger can exist yet
        f"beam_ros: two ROS 2 installations would mix: {what} came back after it was cleared; expected only "
        f"{sys.prefix}; remove what sets it (a sitecustomize or usercustomize module, a wrapper script)",
        file=sys.stderr,
    )
    return 2


def _site_packages(prefix: Path) -> Path:
    return prefix / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"


def _entries(environ: Mapping[str, str], name: str) -> list[str]:
    return [entry for entry in environ.get(name, "").split(os.pathsep) if entry]


def _is_inside(entry: str, prefix: Path) -> bool:
    real, real_prefix = os.path.realpath(entry), os.path.realpath(prefix)
    return real == real_prefix or real.startswith(real_prefix + os.sep)


def _holds_interpreter(entry: str) -> bool:
    try:
        return any(file.startswith("libpython3") for file in os.listdir(entry))
    except OSError:
        return False
