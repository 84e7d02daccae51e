"""Write the sources of the API reference: a page for every room that holds public names of a package.

The public names are those that a package offers itself, and the module that defines a name says where it
stands. Where a package offers none, the public names are those of its modules. Nothing is listed by hand.
"""

from __future__ import annotations

import re
from collections import defaultdict
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from types import ModuleType
from typing import Any

from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

FOLDER = "api"


def exported(package: ModuleType) -> list[str]:
    """Return the names that a package offers itself: its ``__all__``, or what its ``__init__`` imports."""
    own = [
        name
        for name, value in vars(package).items()
        if not name.startswith("_") and not isinstance(value, ModuleType)
    ]
    return list(getattr(package, "__all__", [name for name in own if name != "annotations"]))


def rooms_of(package: ModuleType) -> dict[str, dict[str, list[str]]]:
    """Return a package's public names by room and by the module that defines them.

    Parameters
    ----------
    package : module

    Returns
    -------
    dict of str to dict of str to list of str -- room, module, names; a room is a package or sub-package
    """
    names_of: dict[str, list[str]] = defaultdict(list)
    if names := exported(package):
        for name in sorted(names, key=str.lower):
            names_of[module_of(package, name)].append(name)
    else:
        for found in walk_packages(package.__path__, f"{package.__name__}."):
            module = import_module(found.name)
            own = [name for name in vars(module) if is_defined_in(module, name)]
            names_of[found.name] += sorted(own, key=str.lower)
    rooms: dict[str, dict[str, list[str]]] = defaultdict(dict)
    for module_name, names in sorted(names_of.items()):
        if names:
            is_room = hasattr(import_module(module_name), "__path__")
            rooms[module_name if is_room else module_name.rpartition(".")[0]][module_name] = names
    return dict(sorted(rooms.items()))


def is_defined_in(module: ModuleType, name: str) -> bool:
    """Return whether a public class, function or described constant is defined in this very module."""
    if name.startswith("_"):
        return False
    public = getattr(module, name)
    if isinstance(public, type) or callable(public):
        return getattr(public, "__module__", "") == module.__name__
    return ("", name) in ModuleAnalyzer.for_module(module.__name__).find_attr_docs()


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


def page_of_room(package: ModuleType, room: str, modules: dict[str, list[str]], below: list[str]) -> str:
    """Return the source of one room's page.

    Parameters
    ----------
    package : module -- from which a reader imports the names, where it offers them itself
    room : str -- dotted name of the sub-package, or of the package itself
    modules : dict of str to list of str -- public names by the module that defines them
    below : list of str -- rooms whose pages are listed on this one

    Returns
    -------
    str -- reStructuredText
    """
    lines = heading(room if room == package.__name__ else room.rpartition(".")[2], "=")
    if room not in modules:
        lines += [f".. automodule:: {room}", "   :no-members:", ""]
    lines += contents(below) if below else []
    for module in sorted(modules, key=lambda name: (name != room, name)):
        if module != room:
            lines += heading(module.rpartition(".")[2], "-")
        lines += [f".. automodule:: {module}", "   :no-members:", ""]
        source = package if exported(package) else import_module(module)
        lines += [f".. currentmodule:: {source.__name__}", ""]
        for name in modules[module]:
            public = getattr(source, name)
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
        inner = [room for room in rooms if room != package_name]
        pages |= {room: page_of_room(package, room, rooms[room], []) for room in inner}
        pages[package_name] = page_of_room(package, package_name, rooms.get(package_name, {}), inner)
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
