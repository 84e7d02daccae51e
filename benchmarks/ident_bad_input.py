"""Print the table of bad input: each estimator against each fault of its data.

``python -m benchmarks.ident_bad_input`` runs all cases, ``--estimators`` and ``--faults`` those whose names hold a
word, ``--failures`` prints failures alone.  Exit status 1 where there is a failure.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

from tests.beam_ident.bad_input.estimators import ESTIMATORS
from tests.beam_ident.bad_input.faults import cases
from tests.beam_ident.bad_input.judgement import judge


def main() -> int:
    """Run the cases asked for and print what came of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--estimators", default="", help="a part of their names")
    parser.add_argument("--faults", default="", help="a part of their names")
    parser.add_argument("--failures", action="store_true", help="print failures alone")
    parser.add_argument("--width", type=int, default=150, help="of what is printed of a message")
    asked = parser.parse_args()
    counts: Counter[str] = Counter()
    start, slowest = time.perf_counter(), (0.0, "")
    for estimator, fault in cases(ESTIMATORS):
        if asked.estimators not in estimator or asked.faults not in fault:
            continue
        verdict = judge(estimator, fault)
        counts[verdict.kind] += 1
        slowest = max(slowest, (verdict.seconds, f"{estimator}, {fault}"))
        if verdict.is_failure or not asked.failures:
            print(f"{fault} | {estimator} | {verdict.kind} | {verdict.text[: asked.width]}", flush=True)
    failures = sum(counts[kind] for kind in ("silent", "crash", "too slow"))
    print(
        f"{counts.total()} cases in {time.perf_counter() - start:.0f} s (slowest {slowest[0]:.1f} s: {slowest[1]}): "
        f"{', '.join(f'{n} {kind}' for kind, n in counts.most_common())}; {failures} failures"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
