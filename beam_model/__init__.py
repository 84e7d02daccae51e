"""The physics of a flexible cantilever beam on a moving hub.

Parameters, clamped modes, Galerkin matrices, frequency responses, state spaces and exact stepping; the closed-form
response of the continuous beam as a yardstick; advice for experiments. NumPy and SciPy only, but for ``figures``,
which imports Matplotlib when it draws.

Every name is loaded from its room when it is first used, so that a program which only reads parameters does not wait
for SciPy. The names stand in ``__init__.pyi``, where type checkers find them too.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any

_MODULE_OF = {
    name: module
    for module, name in re.findall(
        r"^from ([\w.]+) import \(?\s*(\w+) as",
        Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"),
        re.M,
    )
}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    """Load an exported name from its module (PEP 562)."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
