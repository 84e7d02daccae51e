"""Write the sources of the API reference: a page for every room that holds public names of a package.

A package's ``__all__`` says which names are public, and the module that defines a name says where it stands.
Nothing is listed by hand.
"""

from __future__ import annotations

import re
from collections import defaultdict
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

FOLDER = "api"


def rooms_of(package: ModuleType) -> dict[str, dict[str, list[str]]]:
    """Return a package's public names by room and by the module that defines them.

    Parameters
    ----------
    package : module -- with ``__all__``

    Returns
    -------
    dict of str to dict of str to list of str -- room, module, names; modules that are in no sub-package
        belong to the package's own room
    """
    rooms: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for name in sorted(package.__all__, key=str.lower):
        module = module_of(package, name)
        parts = module.removeprefix(package.__name__).strip(".").split(".")
        room = f"{package.__name__}.{parts[0]}" if len(parts) > 1 else package.__name__
        rooms[room][module].append(name)
    return dict(sorted(rooms.items()))


def module_of(package: ModuleType, name: str) -> str:
    """Return the dotted name of the module that defines a public name.

    A class and a function say it themselves; a constant is looked for in the code of the package's modules.
    """
    public = getattr(package, name)
    if isinstance(public, type) or callable(public):
        return str(public.__module__)
    for path in sorted(Path(str(package.__file__)).parent.rglob("*.py")):
        if re.search(rf"^{name}\b[^=\n]*=", path.read_text(encoding="utf-8"), flags=re.MULTILINE):
            inner = path.relative_to(Path(str(package.__file__)).parent).with_suffix("").parts
            return ".".join([package.__name__, *(part for part in inner if part != "__init__")])
    return package.__name__


def page_of_room(package: ModuleType, room: str, modules: dict[str, list[str]]) -> str:
    """Return the source of one room's page.

    Parameters
    ----------
    package : module -- from which a reader imports the names
    room : str -- dotted name of the sub-package, or of the package itself
    modules : dict of str to list of str -- public names by the module that defines them

    Returns
    -------
    str -- reStructuredText
    """
    lines = heading(room if room == package.__name__ else room.rpartition(".")[2], "=")
    if room not in modules:
        lines += [f".. automodule:: {room}", "   :no-members:", ""]
    for module in sorted(modules, key=lambda name: (name != room, name)):
        if module != room:
            lines += heading(module.rpartition(".")[2], "-")
        lines += [f".. automodule:: {module}", "   :no-members:", ""]
        lines += [f".. currentmodule:: {package.__name__}", ""]
        for name in modules[module]:
            public = getattr(package, name)
            if isinstance(public, type):
                lines += [f".. autoclass:: {name}", "   :members:", ""]
            elif callable(public):
                lines += [f".. autofunction:: {name}", ""]
            else:
                lines += constant(module, name, public)
    return "\n".join(lines)


def constant(module: str, name: str, value: object) -> list[str]:
    """Return the source that shows a constant: with the words below it in the code, or else with its value."""
    if ("", name) in ModuleAnalyzer.for_module(module).find_attr_docs():
        return [f".. autodata:: {module}.{name}", "   :no-value:", ""]
    shown = repr(value)
    return [f".. data:: {name}", *([f"   :value: {shown}"] if len(shown) < 100 else []), ""]


def heading(words: str, line: str) -> list[str]:
    """Return the source of a heading."""
    return [words, line * len(words), ""]


def contents(pages: list[str]) -> list[str]:
    """Return the source of a list of pages."""
    return [".. toctree::", "   :maxdepth: 1", "", *(f"   {page}" for page in pages), ""]


def write_pages(app: Sphinx) -> None:
    """Write every page, and the index that lists them; a page that has not changed is left alone."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    pages: dict[str, str] = {}
    for package_name in app.config.api_packages:
        package = import_module(package_name)
        rooms = rooms_of(package)
        for room, modules in rooms.items():
            pages[room] = page_of_room(package, room, modules)
        own = pages.get(package_name) or page_of_room(package, package_name, {})
        pages[package_name] = own + "\n".join(
            ["", *contents([room for room in rooms if room != package_name])]
        )
    pages["index"] = "\n".join([*heading("API reference", "="), *contents(app.config.api_packages)])
    for old in folder.glob("*.rst"):
        if old.stem not in pages:
            old.unlink()
    for name, text in pages.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages before Sphinx looks for sources."""
    app.add_config_value("api_packages", [], "env")
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True}
