"""Seeded mutations of the three packages against the tests that run the mutated line (``make mutants``).

Each mutation is made by cosmic-ray in a copy of the tree, so that the tree itself is never touched and
several workers run side by side. Only the tests that run the mutated line are started, the quickest files
first, until one fails: the quick ones, with ``--all`` the slow ones as well. Which test runs which line is measured
once for each state of the tree and kept in ``.mutants/``, together with the result of each draw.

A mutation that changes nothing that can be measured is named in ``equivalent.yaml``, with the reason.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from ruamel.yaml import YAML

from tests.mutants.covering import CoverageMap
from tests.mutants.mutations import PACKAGES, Mutation, draw

ROOT = Path(__file__).resolve().parents[2]
CACHE = ROOT / ".mutants"

NOT_MEASURED = "tests/packaging"
"""These tests install the suite elsewhere: the lines that they run are not in this tree."""

REQUIRED = {False: 0.85, True: 0.9}
"""Share of the mutations that are not equivalent which the quick tests, and all tests, have to kill."""


def main() -> int:
    """Draw, test, list the survivors; the exit status is 0 when enough mutations are killed."""
    options = _options()
    selection = ["--all"] if options.all else []
    cache = CACHE / ("all" if options.all else "quick")
    cache.mkdir(parents=True, exist_ok=True)
    if options.measure or not options.keep_map:
        _measure(cache, selection, options.measure)
    if options.measure:
        return 0
    coverage_map = CoverageMap(cache, ROOT)
    results_file = cache / f"seed-{options.seed}-{options.count}.json"
    equivalent = {
        (entry["file"], entry["line"], entry["becomes"]): entry["reason"]
        for entry in YAML(typ="safe").load(Path(__file__).with_name("equivalent.yaml"))
    }
    before = json.loads(results_file.read_text()) if options.again else {}
    results: dict[str, str] = {}
    trees: SimpleQueue[Path] = SimpleQueue()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        for worker in range(options.workers):
            trees.put(_copy(Path(folder) / str(worker)))

        def test(mutation: Mutation) -> None:
            change = mutation.change(ROOT)
            key = f"{mutation.path}:{mutation.position[0]}:{mutation.position[1]} {mutation.operator}"
            if (mutation.path, *change) in equivalent:
                outcome = "equivalent: " + equivalent[(mutation.path, *change)]
            elif before.get(key, "").startswith("killed"):
                outcome = before[key]
            else:
                tree = trees.get()
                start = time.monotonic()
                outcome = _outcome(mutation, tree, coverage_map, selection, options.budget)
                outcome += f" ({time.monotonic() - start:.0f} s)"
                trees.put(tree)
            results[key] = outcome
            results_file.write_text(json.dumps({**before, **results}, indent=1))
            print(
                f"{len(results):4d} {key}\n     - {change[0]}\n     + {change[1]}\n     {outcome}", flush=True
            )

        with ThreadPoolExecutor(options.workers) as pool:
            list(pool.map(test, draw(ROOT, options.count, options.seed)))
    return _summary(results, REQUIRED[options.all])


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make mutants", description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200, help="mutations to draw (200)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the draw (1)")
    parser.add_argument("--workers", type=int, default=2, help="mutations under test at a time (2)")
    parser.add_argument("--budget", type=float, default=120.0, help="seconds of tests for one mutation (120)")
    parser.add_argument("--all", action="store_true", help="let the slow tests judge as well")
    parser.add_argument("--again", action="store_true", help="test only what this draw has not killed before")
    parser.add_argument(
        "--measure", action="store_true", help="measure anew which test runs which line, and stop"
    )
    parser.add_argument(
        "--keep-map", action="store_true", help="use the last measurement, though files changed"
    )
    return parser.parse_args()


def _measure(cache: Path, selection: list[str], is_fresh: bool) -> None:
    """Run the tests once and note the lines that each runs, unless that is known for this tree."""
    digest = hashlib.sha256()
    for folder in (*PACKAGES, "tests"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            digest.update(file.relative_to(ROOT).as_posix().encode() + file.read_bytes())
    state = cache / "state"
    if not is_fresh and state.exists() and state.read_text() == digest.hexdigest():
        return
    print(
        "Measuring which test runs which line; this takes as long as these tests one after another.",
        flush=True,
    )
    for old in cache.glob("coverage*"):
        old.unlink()
    configuration = Path(__file__).with_name("coverage.ini")
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = _copy(Path(folder) / "tree")
        started = {"MUTANTS_CACHE": str(cache), "COVERAGE_PROCESS_START": str(configuration)}
        arguments = [*selection, "--ignore", NOT_MEASURED, "tests"]
        _pytest(tree, "tests.mutants.coverage_map", arguments, started, None)
        combine = [sys.executable, "-m", "coverage", "combine", "-q", f"--rcfile={configuration}"]
        subprocess.run(combine, cwd=tree, env=os.environ | {"MUTANTS_CACHE": str(cache)}, check=True)
    state.write_text(digest.hexdigest())


def _copy(tree: Path) -> Path:
    """Copy what git keeps or would keep, compiled."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    for name in subprocess.run(listed, cwd=ROOT, capture_output=True, check=True).stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
    subprocess.run([sys.executable, "-m", "compileall", "-q", *PACKAGES, "tests"], cwd=tree, check=True)
    return tree


def _outcome(
    mutation: Mutation, tree: Path, coverage_map: CoverageMap, selection: list[str], budget_s: float
) -> str:
    """Test a mutation in a copy of the tree and restore the copy."""
    chosen = coverage_map.tests(mutation, budget_s)
    if not chosen:
        return "survived: no test runs the line"
    source = (ROOT / mutation.path).read_text()
    (tree / mutation.path).write_text(mutation.apply(source) or source)
    try:
        failed = _first_failure(tree, chosen, coverage_map, selection)
    finally:
        shutil.copy2(ROOT / mutation.path, tree / mutation.path)
    return f"killed by {failed}" if failed else f"survived {len(chosen)} tests"


def _first_failure(
    tree: Path, chosen: dict[str, float], coverage_map: CoverageMap, selection: list[str]
) -> str:
    """Run tests until one fails; return its name, or nothing."""
    listed = tree.with_suffix(".json")
    listed.write_text(json.dumps({"chosen": chosen, "known": list(coverage_map.durations_s)}))
    files = dict.fromkeys(test.partition("::")[0] for test in chosen)
    limit_s = 120.0 + 10.0 * sum(chosen.values())
    arguments = [*selection, "-x", *files]
    ran = _pytest(tree, "tests.mutants.selected_tests", arguments, {"MUTANTS_SELECTED": str(listed)}, limit_s)
    if ran is None:
        return "the time limit"
    if ran.returncode == 0:
        return ""
    named = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", ran.stdout, re.M)
    return named[1] if named else f"pytest's exit status {ran.returncode}"


def _pytest(
    tree: Path, plugin: str, arguments: list[str], variables: dict[str, str], limit_s: float | None
) -> subprocess.CompletedProcess[str] | None:
    """Run pytest in a copy of the tree; None when its time has run out."""
    plugins = ["-p", plugin, "-p", "no:cacheprovider"]
    command = [sys.executable, "-m", "pytest", "-q", "--no-header", *plugins, *arguments]
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", **variables}
    try:
        return subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return None


def _summary(results: dict[str, str], required: float) -> int:
    """Print the share killed in each package and in all, and what survived."""
    shares = {}
    for package in (*PACKAGES, ""):
        judged = [
            row
            for key, row in results.items()
            if key.startswith(package) and not row.startswith("equivalent")
        ]
        killed = sum(row.startswith("killed") for row in judged)
        shares[package] = killed / len(judged) if judged else 1.0
        print(f"{package or 'in all':12} {killed} of {len(judged)} killed ({shares[package]:.1%})")
    for key, row in sorted(results.items()):
        if row.startswith("survived"):
            print(f"  survived: {key}: {row}")
    return 0 if shares[""] >= required else 1


if __name__ == "__main__":
    sys.exit(main())
