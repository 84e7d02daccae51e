"""The graph of the rooms: files and lines of each, what it imports, cycles, and the longest chain.

Ends with status 1 where a chain is too long, or arrows run in a circle. Which room may import which
stands in `.importlinter`; this page measures what came of it.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import defaultdict
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("beam_model", "beam_ident", "beam_ros")
LONGEST_CHAIN = 8


def code_lines(source: str) -> int:
    """Count the lines that hold code: neither blank, nor comment, nor docstring."""
    quiet = (
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    )
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in quiet:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def chain_from(room: str, arrows: dict[str, set[str]], above: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the longest chain of rooms that begins at one; a circle is an error."""
    if room in above:
        raise SystemExit(f"the rooms {' -> '.join([*above[above.index(room) :], room])} import each other")
    below = [chain_from(other, arrows, (*above, room)) for other in arrows[room]]
    return (room, *max(below, key=len, default=()))


def main() -> int:
    """Print the rooms of every package; return 1 where one is not as it should be."""
    sys.path.insert(0, str(ROOT))
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    faults = []
    for package in PACKAGES:
        files, lines, arrows = defaultdict(list), defaultdict(int), defaultdict(set)
        for path in sorted((ROOT / package).rglob("*.py")):
            room = ".".join(path.parent.relative_to(ROOT).parts)
            lines[room] += code_lines(path.read_text(encoding="utf-8"))
            if path.name != "__init__.py":
                files[room].append(path.stem)
        room_of = {f"{room}.{name}": room for room, names in files.items() for name in names}
        for module, room in room_of.items():
            for imported in graph.find_modules_directly_imported_by(module):
                other = room_of.get(imported, imported if imported in lines else room)
                if other not in (room, package):
                    arrows[room].add(other)
        print(f"\n{package}: {sum(lines.values())} lines of code in {len(lines)} rooms")
        for room in sorted(lines):
            below = ", ".join(sorted(other.removeprefix(f"{package}.") for other in arrows[room]))
            print(f"  {room:<44}{len(files[room]):3} files {lines[room]:6} lines   {below}")
        longest = max((chain_from(room, arrows) for room in list(lines)), key=len)
        print(f"  longest chain, {len(longest)} rooms: {' -> '.join(longest)}")
        if len(longest) > LONGEST_CHAIN:
            faults.append(f"{package} has a chain of {len(longest)} rooms; expected at most {LONGEST_CHAIN}")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
