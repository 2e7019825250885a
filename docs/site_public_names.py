"""The reference of every public name, from its docstring.

The directive ``public-names`` stands for all of ``__all__`` of a package: a table of names, then an entry for each. A
name that another package documents already is a line that leads there. Once the site is built, every line of
``tests/data/public_names.txt`` must have been found in it.
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
BESIDE: Final = ("loi_core.renderers", "loi_core.errors")
"""Packages that have a page although they are not on record."""


class PublicNames(SphinxDirective):
    """The public names of the package that is given."""

    required_arguments = 1
    _entries: ClassVar[dict[str, str]] = {
        "class": ".. autoclass:: {name}\n   :show-inheritance:\n   :members: {members}\n",
        "exception": ".. autoexception:: {name}\n   :show-inheritance:\n   :members: {members}\n",
        "function": ".. autofunction:: {name}\n",
        "plain": ".. py:{role}:: {name}\n\n   {text}\n",
    }

    def run(self) -> list[nodes.Node]:
        """The nodes of the table and of the entries."""
        package = self.arguments[0]
        names = sorted(_all(package), key=str.casefold)
        table = [f"| {{py:obj}}`{one} <{_home(package, one)}>` | {_summary(package, one)} |" for one in names]
        text = [
            "```{eval-rst}",
            f".. py:module:: {package}",
            "```",
            "",
            "| name | what it is |",
            "| --- | --- |",
            *table,
        ]
        own = [one for one in names if package not in BESIDE or _home(package, one) == f"{package}.{one}"]
        for one in own:
            text += ["", "```{eval-rst}", self._entry(package, one), "```"]
        made: list[nodes.Node] = self.parse_text_to_nodes("\n".join(text))
        return made

    def _entry(self, package: str, name: str) -> str:
        thing, full, home = _thing(package, name), f"{package}.{name}", _home(package, name)
        kind = _kind(thing)
        if home != full:
            return self._entries["plain"].format(role=kind, name=name, text=f"The same as :py:obj:`{home}`.")
        if kind == "data":
            return self._entries["plain"].format(role=kind, name=name, text=_comment(package, name))
        return self._entries[kind].format(
            name=full, members=", ".join(_members(thing)) if inspect.isclass(thing) else ""
        )


def _thing(package: str, name: str) -> Any:
    return getattr(importlib.import_module(package), name)


def _all(package: str) -> list[str]:
    return list(importlib.import_module(package).__all__)


def _kind(thing: Any) -> str:
    if inspect.isclass(thing):
        return "exception" if issubclass(thing, BaseException) else "class"
    return "function" if inspect.isroutine(thing) else "data"


def _packages() -> list[str]:
    """Of all names with an entry, in the order of the record, which begins with what most programs import."""
    lines = (line for line in RECORD.read_text().splitlines() if not line.startswith(" "))
    return [*dict.fromkeys(re.split(r"[(:]", line)[0].rpartition(".")[0] for line in lines), *BESIDE]


def _comment(package: str, name: str) -> str:
    """What the source says below an assignment, in whichever module that is."""
    thing = _thing(package, name)
    for module in [one for key, one in sys.modules.items() if key.startswith("loi_")]:
        if vars(module).get(name) is thing:
            said = ModuleAnalyzer.for_module(module.__name__).find_attr_docs().get(("", name))
            if said:
                return " ".join(said).strip()
    msg = f"{package}.{name} has no comment that says what it is"
    raise ExtensionError(msg)


def _home(package: str, name: str) -> str:
    """Under which name the thing is documented: that of the first package that has it."""
    thing = _thing(package, name)
    if _kind(thing) == "data":
        return f"{package}.{name}"
    return next(f"{one}.{name}" for one in _packages() if name in _all(one) and _thing(one, name) is thing)


def _members(thing: Any) -> list[str]:
    """Public methods and properties of the class itself, and what else has a comment; fields are described with it."""
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
    text = _comment(package, name) if _kind(thing) == "data" else inspect.getdoc(thing) or ""
    first = text.split("\n\n")[0].replace("\n", " ")
    sentence = re.split(r"(?<=\.)(?<!eq\.)(?<!eqs\.)\s(?=[A-Z`0-9*])", first)[0]
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", sentence).replace("``", "`").replace("|", r"\|")


def _public_bases(app: Sphinx, name: str, thing: Any, options: Any, bases: list[Any]) -> None:
    """Of the bases of a class, those that have an entry; leaves none of the rest for a reader to wonder about."""
    del app, name, thing, options
    public = {
        id(getattr(importlib.import_module(package), one)): f":py:obj:`{_home(package, one)}`"
        for package in _packages()
        for one in _all(package)
    }
    bases[:] = [public.get(id(base), f"``{base.__module__}.{base.__qualname__}``") for base in bases]


def _names_on_record() -> Iterator[tuple[str, str]]:
    """Each public name, and the member of it that a line is about, or ""."""
    owner = ""
    for line in RECORD.read_text().splitlines():
        name = re.split(r"[(: ]", line.strip())[0]
        if line.startswith(" "):
            yield owner, name.removeprefix(".")
        else:
            owner = name
            yield owner, ""


def _has_entry(thing: Any, owner: str, member: str, documented: set[str]) -> bool:
    """A member needs no entry of its own where its class describes it, or where a base of that has one."""
    if not member:
        return owner in documented
    if f"{owner}.{member}" in documented:
        return True
    described = re.search(rf"^(?:.*, )?{re.escape(member)}(?:, .*)?(?: :|$)", inspect.getdoc(thing) or "", re.MULTILINE)
    return bool(described) or any(f"{one}.{member}" in documented for one in _bases(thing))


def _bases(thing: Any) -> list[str]:
    """The names of public classes that this one derives from."""
    homes = {id(_thing(one, name)): f"{one}.{name}" for one in reversed(_packages()) for name in _all(one)}
    return [homes[id(base)] for base in thing.__mro__[1:] if id(base) in homes]


def missing_names(documented: set[str]) -> list[str]:
    """Public names on record that have no entry among those documented."""
    missing = []
    for owner, member in _names_on_record():
        package, _, name = owner.rpartition(".")
        where = _home(package, name) if member else owner
        if not _has_entry(_thing(package, name), where, member, documented):
            missing.append(f"{where}.{member}" if member else owner)
    return missing


def _resolve(app: Sphinx, env: Any, node: nodes.Element, text: nodes.Element) -> nodes.Element | None:
    """Names that docstrings use as their module does, such as that of an error; and types that are words."""
    if node.get("refdomain") != "py":
        return None
    domain, name = env.get_domain("py"), str(node["reftarget"]).rpartition(".")[2]
    for full, _, kind, document, anchor, _ in domain.get_objects():
        if full.rpartition(".")[2] == name and kind in ("class", "exception", "function"):
            return make_refnode(app.builder, node["refdoc"], document, anchor, text, full)
    # Only what is written as a reference is one; a field such as "array, shape (H, W), optional" is not.
    return None if "refwarn" in node else text


def _as_markup(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Docstrings hold ``*batch`` and ``|x|`` as they are; and a colon in a property's is no type before it."""
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
    """Called by Sphinx."""
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-bases", _public_bases)
    app.connect("autodoc-process-docstring", _as_markup, priority=400)  # before napoleon reads them
    app.connect("missing-reference", _resolve)
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
