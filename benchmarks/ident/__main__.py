"""Accuracy of the identification in units of the Cramer-Rao bound, study by study.

    python -m benchmarks.ident [STUDY ...] [--runs N] [--workers N] [--json FILE] [--list]

Every study simulates seeded records with a known truth, identifies them without hints
and prints its figures: failures, efficiency (bound over mean-square error, 1 is the
limit; its own scatter is sqrt(2 / runs)), coverage of the 95 % intervals, the largest |z|
and the median time.  Times mean something with one worker on a machine at rest.
"""

from __future__ import annotations

import argparse
import importlib
import json
import pkgutil
import sys
from pathlib import Path

import benchmarks.ident
from benchmarks.ident.study import Study, figures


def studies() -> dict[str, Study]:
    """Return every study of every module of this package, by name."""
    found: dict[str, Study] = {}
    for module in pkgutil.iter_modules(benchmarks.ident.__path__):
        if module.name != "__main__":
            found |= getattr(importlib.import_module(f"benchmarks.ident.{module.name}"), "STUDIES", {})
    return found


def main() -> int:
    """Run the studies named on the command line, or all."""
    known = studies()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ident", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "studies", nargs="*", metavar="STUDY", help="names from --list; all when none is given"
    )
    parser.add_argument("--runs", type=int, help="runs per study instead of each study's own number")
    parser.add_argument("--workers", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--json", type=Path, help="write the figures to this file, after every study")
    parser.add_argument("--list", action="store_true", help="list the studies")
    arguments = parser.parse_args()
    if arguments.list:
        for name, study in known.items():
            print(f"{name:24} {study.runs:6} runs  {study.title}")
        return 0
    unknown = [name for name in arguments.studies if name not in known]
    if unknown:
        parser.error(f"no study {', '.join(unknown)}: expected some of {', '.join(known)}")
    lines = []
    for name in arguments.studies or known:
        line = figures(known[name], arguments.runs, arguments.workers, sys.stderr.isatty())
        lines.append({"name": name, **line})
        print("| " + " | ".join(f"{key}: {value}" for key, value in line.items()) + " |", flush=True)
        if arguments.json is not None:
            arguments.json.write_text(json.dumps(lines, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
