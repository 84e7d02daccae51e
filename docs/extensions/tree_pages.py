"""Take the pages at the root of the tree (README and others) into the documentation, and mend their links.

On a forge a page links to files of the tree. The built pages hold no such files: a link to a page of the
documentation is turned into one between built pages, and a link to any other file becomes its text.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PAGES = {
    "readme": "README.md",
    "contributing": "CONTRIBUTING.md",
    "changelog": "CHANGELOG.md",
    "security": "SECURITY.md",
}
"""Name of the built page, and the file at the root of the tree that it shows."""

_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#:\s]+)(#[^)\s]*)?\)")
_PICTURE = re.compile(r"(!\[[^\]]*\])\(docs/([^)\s]+)\)")


def mend_links(text: str, folder: PurePosixPath, built_from: PurePosixPath) -> str:
    """Return a page with its links as the built pages need them.

    Parameters
    ----------
    text : str -- Markdown
    folder : PurePosixPath -- of the file in the tree, seen from its root
    built_from : PurePosixPath -- folder of the page that shows it, seen from the root

    Returns
    -------
    str -- Markdown
    """
    shown_by = {name: f"docs/{page}.md" for page, name in PAGES.items()}

    def mend(match: re.Match[str]) -> str:
        words, target, anchor = match.group(1), match.group(2), match.group(3) or ""
        path = os.path.normpath(folder / target)
        path = shown_by.get(path, path)
        if not (path.startswith("docs/") and path.endswith(".md")):
            return words
        return f"[{words}]({os.path.relpath(path, built_from)}{anchor})"

    return _PICTURE.sub(r"\1(\2)", _LINK.sub(mend, text))


def _read(app: Sphinx, page: str, source: list[str]) -> None:
    if Path(app.env.doc2path(page)).suffix != ".md":
        return
    built_from = PurePosixPath("docs") / PurePosixPath(page).parent
    if page in PAGES:
        path = Path(app.srcdir).parent / PAGES[page]
        app.env.note_dependency(str(path))
        source[0] = mend_links(path.read_text(encoding="utf-8"), PurePosixPath("."), built_from)
    else:
        source[0] = mend_links(source[0], built_from, built_from)


def setup(app: Sphinx) -> dict[str, Any]:
    """Change pages as they are read."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True}
