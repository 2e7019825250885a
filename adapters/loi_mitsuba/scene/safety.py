"""What is looked at of a scene before Mitsuba makes anything of it: Mitsuba trusts its input, and loi does not.

* Mitsuba loads a plugin that it does not know yet from ``plugins/NAME.so``, and looks in the folder of the scene first.
  So all plugins that it ships are loaded from its own folder beforehand, named or not, since it makes some by itself.
  Any other name must be a plain word, and not that of a library in a folder that Mitsuba looks in.
* Parameters in XML (``<default>``) may double again and again, and elements may be nested until the stack ends. Both
  are counted beforehand.
* Meshes, images and volumes are decoded in C++. A scene that names files is loaded in a process of its own first, which
  may crash, hang or run out of memory; see :mod:`loi_mitsuba.scene.trial`.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import mitsuba as mi

from loi_core.errors import LoiError
from loi_core.io.files import read_bytes
from loi_core.support.wording import described, printable, shown

__all__ = ["SceneLoadError", "check_scene_file", "check_types", "load_own_plugins", "looking_in"]

MOST_XML: Final = 64 * 2**20  # bytes of one file
DEEPEST: Final = 64  # elements within elements
MOST_FILES: Final = 32  # XML files that include each other
MOST_TEXT: Final = 2**20  # characters of one attribute once its parameters are put in
MOST_TEXTS: Final = 2**28  # and of all attributes together

PLUGIN_NAME: Final = re.compile(r"[A-Za-z0-9_]+")
REFERENCE: Final = re.compile(r"\$([A-Za-z0-9_]*)")
LIBRARY_SUFFIXES: Final = (".so", ".dylib", ".dll")
SECONDS: Final = 600.0


class SceneLoadError(LoiError, ValueError):
    """Mitsuba cannot load the scene, or it must not."""


def check_scene_file(path: Path) -> None:
    """Look at an XML scene and all that it names.

    Raises
    ------
    SceneLoadError
        If a file is missing, not a regular one or damaged, a bound is passed, or a plugin is not one of Mitsuba's.
    """
    bounds = _Bounds()
    bounds.check(path)
    nodes = _check_plugins_of(path, bounds.folders)
    named = [*bounds.named, *(value for node in nodes for value in _file_names(node.props))]
    found = _check_regular(named, bounds.folders)
    if named:
        _try_once(str(path), "", None if found is None else [*bounds.files, *found])


def _check_plugins_of(path: Path, folders: Iterable[Path]) -> list[Any]:
    """Look at the plugins of an XML scene, and make sure that Mitsuba's own are loaded; the parser's nodes."""
    with looking_in([Path(mi.__file__).parent, *folders]):
        try:
            state = mi.parser.parse_file(mi.parser.ParserConfig(mi.variant()), str(path))
        except RuntimeError as error:
            raise _refused(path, " ".join(str(error).split())) from None
    _check_plugins((node.props.plugin_name() for node in state.nodes), folders)
    return list(state.nodes)


def check_types(description: Mapping[str, Any]) -> None:
    """Look at the plugins and files that a dict for ``mi.load_dict`` names.

    Raises
    ------
    SceneLoadError
        If a plugin is not one of Mitsuba's, a file is not a regular one, or Mitsuba cannot load a dict of plain values
        that names files.
    """
    _check_plugins((value for key, value in _leaves(description) if key == "type"), ())
    named = [value for key, value in _leaves(description) if key.endswith("filename")]
    found = _check_regular(named, [Path.cwd()])
    if named:
        try:
            plain = json.dumps(description)
        except (TypeError, ValueError):
            return  # it holds objects, so a program has made it
        _try_once("-", plain, found)


def _leaves(description: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The texts in a nest of dicts, by their keys."""
    for key, value in description.items():
        if isinstance(value, Mapping):
            yield from _leaves(value)
        elif isinstance(value, str):
            yield str(key), value


def _file_names(properties: Any) -> Iterator[str]:
    for name in properties.keys():  # noqa: SIM118 - not a mapping
        if name.endswith("filename") and isinstance(properties[name], str):
            yield properties[name]


def _check_regular(named: Collection[str], folders: Iterable[Path]) -> list[Path] | None:
    """Where the named files are; None if some are not there."""
    found = [next((folder / name for folder in folders if (folder / name).exists()), None) for name in named]
    for name, path in zip(named, found, strict=True):
        if path is not None and not path.is_file():
            msg = f"`scene` cannot be loaded: {name} is not a regular file"
            raise SceneLoadError(printable(msg))
    files = [path for path in found if path is not None]
    return files if len(files) == len(found) else None


def _check_plugins(names: Iterable[str], folders: Iterable[Path]) -> None:
    """Refuse plugins that are not Mitsuba's own, once those are loaded."""
    shipped = load_own_plugins()
    resolver = mi.file_resolver()
    places = [Path.cwd(), *folders, *(Path(str(resolver[index])) for index in range(len(resolver)))]
    for name in dict.fromkeys(names):
        if not PLUGIN_NAME.fullmatch(name):
            msg = f"a plugin's name must be letters, digits and underscores, got {shown(name)}"
            raise SceneLoadError(msg)
        if name in shipped:
            continue
        # One of the parser's own types, a plugin registered in Python, or a stranger's library.
        for place in places:
            if any((place / "plugins" / f"{name}{suffix}").exists() for suffix in LIBRARY_SUFFIXES):
                msg = f"the plugin {shown(name)} is not Mitsuba's own but a library in {place / 'plugins'}"
                raise SceneLoadError(printable(f"{msg}; only Mitsuba's own plugins are loaded"))


@functools.cache
def load_own_plugins() -> frozenset[str]:
    """Have Mitsuba load all plugins that it ships, from its own folder; afterwards it looks for none of their names."""
    own = Path(mi.__file__).parent
    names = frozenset(path.stem for path in (own / "plugins").iterdir() if path.suffix in LIBRARY_SUFFIXES)
    with looking_in([own]):
        for name in sorted(names):
            mi.PluginManager.instance().plugin_type(name)
    return names


@contextlib.contextmanager
def looking_in(folders: Iterable[Path], *, also: bool = False) -> Iterator[None]:
    """Have Mitsuba look for files in these folders, `also` or only; what a scene adds is forgotten again."""
    usual = mi.file_resolver()
    resolver = mi.FileResolver(usual) if also else mi.FileResolver()
    if not also:
        resolver.clear()
    for folder in folders:
        resolver.append(str(folder))
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(usual)


class _Bounds:
    """Counts what the XML files of a scene ask for."""

    def __init__(self) -> None:
        self._parameters: dict[str, int] = {}  # how long the value of each is
        self._texts = 0
        self.files: list[Path] = []  # of XML
        self.named: list[str] = []  # files that the parser itself opens

    @property
    def folders(self) -> list[Path]:
        """Where files are looked for."""
        return list(dict.fromkeys(file.absolute().parent for file in self.files))

    def check(self, path: Path) -> None:
        """Read a file and those that it includes."""
        self.files.append(path)
        if len(self.files) > MOST_FILES:
            raise _refused(path, f"more than {MOST_FILES} files include each other")
        try:
            content = read_bytes(path, MOST_XML)
        except FileNotFoundError:
            raise _refused(path, "no such file") from None
        except (OSError, ValueError) as error:
            raise _refused(path, described(error)) from None
        depth = 0

        def begin(tag: str, attributes: dict[str, str]) -> None:
            nonlocal depth
            depth += 1
            if depth > DEEPEST:
                raise _refused(path, f"elements are nested more than {DEEPEST} deep")
            lengths = {name: self._length(path, value) for name, value in attributes.items()}
            if tag == "path":
                raise _refused(path, "<path> is not read; files are looked for in the folder of the scene")
            if tag not in ("include", "default") and "filename" in attributes:
                self._name(path, attributes["filename"])
            if tag == "default" and "name" in attributes:
                if not PLUGIN_NAME.fullmatch(attributes["name"]):
                    raise _refused(path, "a parameter's name must be letters, digits and underscores")
                self._parameters.setdefault(attributes["name"], lengths.get("value", 0))
            if tag == "include" and "filename" in attributes:
                self._include(path, attributes["filename"])

        def end(_: str) -> None:
            nonlocal depth
            depth -= 1

        def doctype(*_: object) -> None:
            raise _refused(path, "a document type is not read; take it out")

        parser = expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = begin, end
        parser.StartDoctypeDeclHandler = doctype
        try:
            parser.Parse(content, True)  # noqa: FBT003 - it takes no keyword
        except (expat.ExpatError, ValueError, LookupError) as error:
            if isinstance(error, LoiError):
                raise
            raise _refused(path, f"not well-formed XML ({described(error)})") from None

    def _name(self, path: Path, name: str) -> None:
        """Note a file that the parser opens where it stands, before anything else could look at it."""
        if "$" in name:
            raise _refused(path, "the files of spectra are named without parameters")
        _check_regular([name], self.folders)
        self.named.append(name)

    def _include(self, path: Path, name: str) -> None:
        if "$" in name:
            raise _refused(path, "files are included by their names, without parameters")
        places = [file.parent / name for file in self.files]
        self.check(next((place for place in places if place.exists()), path.parent / name))

    def _length(self, path: Path, value: str) -> int:
        """How long a value is at the most once its parameters are put in."""
        length = len(value)
        for reference in REFERENCE.findall(value):
            length += max((size for name, size in self._parameters.items() if reference.startswith(name)), default=0)
        self._texts += length
        if length > MOST_TEXT or self._texts > MOST_TEXTS:
            raise _refused(path, f"its parameters make texts of more than {MOST_TEXT} characters")
        return length


def _try_once(path: str, description: str, files: Iterable[Path] | None) -> None:
    """As :func:`_try_to_load`, unless that has been and the files are those that they were; None for unknown ones."""
    if files is None:
        _try_to_load(mi.variant(), path, description)
        return
    told = [(str(file.absolute()), file.stat()) for file in files]
    seen = tuple((name, one.st_dev, one.st_ino, one.st_size, one.st_mtime_ns, one.st_ctime_ns) for name, one in told)
    _tried(mi.variant(), path, description, seen)


@functools.lru_cache(maxsize=64)
def _tried(variant: str, path: str, description: str, _seen: tuple[tuple[str | int, ...], ...]) -> None:
    """Files as they are seen, which keeps none that are refused."""
    _try_to_load(variant, path, description)


def _try_to_load(variant: str, path: str, description: str) -> None:
    """Load a scene in a process of its own: that of a file, or for the path ``-`` of a dict in JSON."""
    command = [sys.executable, "-P", str(Path(__file__).with_name("trial.py")), variant, path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}  # what can be imported here can be there
    try:
        done = subprocess.run(  # noqa: S603 - our own file
            command,
            input=description.encode(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=environment,
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise _refused(path, f"Mitsuba has not loaded it after {SECONDS:g} seconds") from None
    if done.returncode == 0:
        return
    said = done.stderr.decode("utf-8", "replace").strip().splitlines()
    if done.returncode < 0:
        raise _refused(path, f"a file that it names makes Mitsuba crash (signal {-done.returncode})")
    raise _refused(path, said[-1] if said else f"exit code {done.returncode}")


def _refused(path: Path | str, why: str) -> SceneLoadError:
    return SceneLoadError(printable(f"`scene` cannot be loaded: {path}: {why}")[:1000])
