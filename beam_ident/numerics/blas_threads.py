"""Keep the linear algebra of an estimation on one thread.

The estimators multiply thousands of small matrices.  OpenBLAS, which NumPy and SciPy
bring along, spreads each product over all cores and lets its threads spin while they
wait for each other; on a machine that is busy with something else (a simulator, a
camera) that costs up to ten times the work itself.  Inside an estimation the library
is therefore asked for one thread, and afterwards for as many as before.  Where no
OpenBLAS is found (another BLAS, another system than Linux) nothing is done.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

_MAPS = Path("/proc/self/maps")
_PREFIXES = ("scipy_openblas", "openblas")
_SUFFIXES = ("64_", "")


@functools.lru_cache(maxsize=1)
def _controls() -> tuple[tuple[Any, Any], ...]:
    """Return the functions that read and set the threads of every OpenBLAS in this process."""
    try:
        lines = _MAPS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ()
    paths = {
        line.split(maxsplit=5)[5] for line in lines if "openblas" in line and len(line.split(maxsplit=5)) == 6
    }
    found = []
    for path in sorted(paths):
        try:
            library = ctypes.CDLL(path)
        except OSError:
            continue
        for prefix in _PREFIXES:
            for suffix in _SUFFIXES:
                getter = getattr(library, f"{prefix}_get_num_threads{suffix}", None)
                setter = getattr(library, f"{prefix}_set_num_threads{suffix}", None)
                if getter is not None and setter is not None:
                    getter.restype, setter.argtypes = ctypes.c_int, [ctypes.c_int]
                    found.append((getter, setter))
    return tuple(found)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run the body with OpenBLAS on one thread."""
    import scipy.linalg  # noqa: F401  loads SciPy's own OpenBLAS, so that it is found too

    before = [(setter, getter()) for getter, setter in _controls()]
    for setter, _ in before:
        setter(1)
    try:
        yield
    finally:
        for setter, count in before:
            setter(count)


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function run with OpenBLAS on one thread."""

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with one_blas_thread():
            return function(*args, **kwargs)

    return wrapped
