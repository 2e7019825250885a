"""The reference of every public name, from its docstring.

The directive ``public-names`` expands to a table of the names in ``__all__`` of a package and an entry for each; a name
documented by another package becomes a link. After the build, every line of ``tests/data/public_names.txt`` must
have an entry.
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Final

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import make_refnode

RECORD: Final = Path(__file__).parents[1] / "tests" / "data" / "public_names.txt"
UNRECORDED_PACKAGES: Final = ("loi_core.renderers", "loi_core.errors")
"""Packages with a page that are not on record."""


class PublicNames(SphinxDirective):
    """The public names of a package."""

    required_arguments = 1
    _entries: ClassVar[dict[str, str]] = {
        "class": ".. autoclass:: {name}\n   :show-inheritance:\n   :members: {members}\n",
        "exception": ".. autoexception:: {name}\n   :show-inheritance:\n   :members: {members}\n",
        "function": ".. autofunction:: {name}\n",
        "plain": ".. py:{role}:: {name}\n\n   {text}\n",
    }

    def run(self) -> list[nodes.Node]:
        """Return the nodes of the table and of the entries."""
        package = self.arguments[0]
        names = sorted(_all(package), key=str.casefold)
        table = [f"| {{py:obj}}`{name} <{_home(package, name)}>` | {_summary(package, name)} |" for name in names]
        text = [
            "```{eval-rst}",
            f".. py:module:: {package}",
            "```",
            "",
            "| name | description |",
            "| --- | --- |",
            *table,
        ]
        for name in names:
            if package not in UNRECORDED_PACKAGES or _home(package, name) == f"{package}.{name}":
                text += ["", "```{eval-rst}", self._entry(package, name), "```"]
        parsed: list[nodes.Node] = self.parse_text_to_nodes("\n".join(text))
        return parsed

    def _entry(self, package: str, name: str) -> str:
        thing, full, home = _thing(package, name), f"{package}.{name}", _home(package, name)
        role = _role(thing)
        if home != full:
            return self._entries["plain"].format(role=role, name=name, text=f"Alias of :py:obj:`{home}`.")
        if role == "data":
            return self._entries["plain"].format(role=role, name=name, text=_comment(package, name))
        return self._entries[role].format(
            name=full, members=", ".join(_members(thing)) if inspect.isclass(thing) else ""
        )


def _thing(package: str, name: str) -> Any:
    return getattr(importlib.import_module(package), name)


def _all(package: str) -> list[str]:
    return list(importlib.import_module(package).__all__)


def _role(thing: Any) -> str:
    if inspect.isclass(thing):
        return "exception" if issubclass(thing, BaseException) else "class"
    return "function" if inspect.isroutine(thing) else "data"


def _packages() -> list[str]:
    """Return the packages of all names with an entry, in the order of the record."""
    lines = (line for line in RECORD.read_text().splitlines() if not line.startswith(" "))
    return [*dict.fromkeys(re.split(r"[(:]", line)[0].rpartition(".")[0] for line in lines), *UNRECORDED_PACKAGES]


def _comment(package: str, name: str) -> str:
    """Return the comment below an assignment, in any module."""
    thing = _thing(package, name)
    for module in [module for key, module in sys.modules.items() if key.startswith(("loi_", "mitsuba_boundaries"))]:
        if vars(module).get(name) is thing:
            comment = ModuleAnalyzer.for_module(module.__name__).find_attr_docs().get(("", name))
            if comment:
                return " ".join(comment).strip()
    msg = f"{package}.{name} has no comment"
    raise ExtensionError(msg)


def _home(package: str, name: str) -> str:
    """Return the documented name of an object, in the first package that exports it."""
    thing = _thing(package, name)
    if _role(thing) == "data":
        return f"{package}.{name}"
    return next(
        f"{exporter}.{name}" for exporter in _packages() if name in _all(exporter) and _thing(exporter, name) is thing
    )


def _members(thing: Any) -> list[str]:
    """Return public methods, properties and commented attributes of a class; its docstring describes fields."""
    commented = {
        name for owner, name in ModuleAnalyzer.for_module(thing.__module__).find_attr_docs() if owner == thing.__name__
    }
    return [
        name
        for name, value in vars(thing).items()
        if not name.startswith("_")
        and (isinstance(value, property | classmethod | staticmethod) or inspect.isfunction(value) or name in commented)
    ]


def _summary(package: str, name: str) -> str:
    thing = _thing(package, name)
    text = _comment(package, name) if _role(thing) == "data" else inspect.getdoc(thing) or ""
    first = text.split("\n\n")[0].replace("\n", " ")
    sentence = re.split(r"(?<=\.)(?<!eq\.)(?<!eqs\.)\s(?=[A-Z`0-9*])", first)[0]
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", sentence).replace("``", "`").replace("|", r"\|")


def _public_bases(app: Sphinx, name: str, thing: Any, options: Any, bases: list[Any]) -> None:
    """Link the bases of a class that have an entry."""
    del app, name, thing, options
    public = {
        id(getattr(importlib.import_module(package), exported)): f":py:obj:`{_home(package, exported)}`"
        for package in _packages()
        for exported in _all(package)
    }
    bases[:] = [public.get(id(base), f"``{base.__module__}.{base.__qualname__}``") for base in bases]


def _names_on_record() -> Iterator[tuple[str, str]]:
    """Yield each public name, with the member of its line or an empty text."""
    owner = ""
    for line in RECORD.read_text().splitlines():
        name = re.split(r"[(: ]", line.strip())[0]
        if line.startswith(" "):
            yield owner, name.removeprefix(".")
        else:
            owner = name
            yield owner, ""


def _has_entry(thing: Any, owner: str, member: str, documented: set[str]) -> bool:
    """Return whether an entry documents a member, its class's docstring describes it, or a base class has an entry."""
    if not member:
        return owner in documented
    if f"{owner}.{member}" in documented:
        return True
    described = re.search(rf"^(?:.*, )?{re.escape(member)}(?:, .*)?(?: :|$)", inspect.getdoc(thing) or "", re.MULTILINE)
    return bool(described) or any(f"{base}.{member}" in documented for base in _bases(thing))


def _bases(thing: Any) -> list[str]:
    """Return the names of the public base classes."""
    homes = {
        id(_thing(package, name)): f"{package}.{name}" for package in reversed(_packages()) for name in _all(package)
    }
    return [homes[id(base)] for base in thing.__mro__[1:] if id(base) in homes]


def missing_names(documented: set[str]) -> list[str]:
    """Return public names on record without a documented entry."""
    missing = []
    for owner, member in _names_on_record():
        package, _, name = owner.rpartition(".")
        documented_owner = _home(package, name) if member else owner
        if not _has_entry(_thing(package, name), documented_owner, member, documented):
            missing.append(f"{documented_owner}.{member}" if member else owner)
    return missing


def _resolve(app: Sphinx, env: Any, node: nodes.Element, text: nodes.Element) -> nodes.Element | None:
    """Resolve unqualified names in docstrings, such as errors, and types that are words."""
    if node.get("refdomain") != "py":
        return None
    domain, name = env.get_domain("py"), str(node["reftarget"]).rpartition(".")[2]
    for full, _, role, document, anchor, _ in domain.get_objects():
        if full.rpartition(".")[2] == name and role in ("class", "exception", "function"):
            return make_refnode(app.builder, node["refdoc"], document, anchor, text, full)
    # A field such as "array, shape (H, W), optional" is no reference.
    return None if "refwarn" in node else text


def _as_markup(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Escape ``*batch`` and ``|x|`` in docstrings, and keep a colon in a property's from marking a type."""
    del app, name, thing, options
    lines[:] = [re.sub(r"(?<![*`])\*(?=batch)", r"\\*", re.sub(r"(?<!`)\|(?!`)", r"\|", line)) for line in lines]
    if what in ("property", "attribute"):
        lines.insert(0, "\\ ")


def _check(app: Sphinx, failed: Exception | None) -> None:
    if failed is not None or app.builder.format != "html":
        return
    documented = {name for name, *_ in app.env.get_domain("py").get_objects()}
    total, missing = len(list(_names_on_record())), missing_names(documented)
    print(f"reference: {total - len(missing)} of {total} public names have an entry")
    if missing:
        msg = f"without an entry in the reference: {', '.join(missing)}"
        raise ExtensionError(msg)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension; called by Sphinx."""
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-bases", _public_bases)
    app.connect("autodoc-process-docstring", _as_markup, priority=400)  # before napoleon reads them
    app.connect("missing-reference", _resolve)
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
