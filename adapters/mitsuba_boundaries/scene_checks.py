"""Check the names of plugins and files before Mitsuba loads a scene.

Mitsuba loads an unknown plugin from ``plugins/NAME.so`` and searches the scene's folder before its own. Therefore all
plugins that Mitsuba ships are loaded from its own folder first, and any other name must be a plain word that no library
in a searched folder has. This includes plugins that Mitsuba instantiates by default, such as a film's filter.

Mitsuba would wait for the content of a named pipe forever, so a text of a scene that names a pipe or device is refused.
"""

from __future__ import annotations

import functools
import html
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import mitsuba as mi

from mitsuba_boundaries.loading import file_search_path

__all__ = ["UnsafeSceneError", "check_scene", "load_shipped_plugins"]

PLUGIN_NAME: Final = re.compile(r"[A-Za-z0-9_]+")
QUOTED_TEXT: Final = re.compile("\"([^\"]*)\"|'([^']*)'")
MAX_SHOWN_LENGTH: Final = 60  # letters of a plugin's name in a message
LIBRARY_SUFFIXES: Final = (".so", ".dylib", ".dll")


class UnsafeSceneError(ValueError):
    """A scene names a plugin that is not Mitsuba's own, or a file that is a pipe or device."""


def check_scene(scene: Mapping[str, Any] | Path) -> None:
    """Check the plugins and files that a scene names, in a dict for ``mi.load_dict`` or in an XML file.

    An XML file is checked with the files that it includes.

    Raises
    ------
    UnsafeSceneError
        If a plugin is neither Mitsuba's own nor registered, or a named file is a pipe or device.
    RuntimeError
        If Mitsuba cannot parse the file.
    """
    if isinstance(scene, Path):
        _check_scene_file(scene)
        return
    texts = list(_texts(scene))
    _check_files((text for _, text in texts), _searched_folders())
    _check_plugins((text for key, text in texts if key == "type"), ())


def _check_scene_file(path: Path) -> None:
    if not path.is_file():
        msg = f"{path}: {'not a regular file' if path.exists() else 'no such file'}"
        raise UnsafeSceneError(msg)
    _check_files_of(path, [path.absolute().parent, *_searched_folders()], set())
    with file_search_path([path.parent], extend=True):  # <path> elements add folders, which must not outlive the parser
        state = mi.parser.parse_file(mi.parser.ParserConfig(mi.variant()), str(path))
        folders = [Path(str(file)).absolute().parent for file in (path, *state.files)]
        _check_plugins((node.props.plugin_name() for node in state.nodes), folders)


def _texts(description: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in description.items():
        if isinstance(value, Mapping):
            yield from _texts(value)
        elif isinstance(value, str):
            yield key, value


def _searched_folders() -> list[Path]:
    resolver = mi.file_resolver()
    return [Path.cwd(), *(Path(str(resolver[index])) for index in range(len(resolver)))]


def _check_files_of(path: Path, folders: Iterable[Path], checked: set[Path]) -> None:
    """Check the quoted texts of an XML file, and of the XML files that they name."""
    checked.add(path)
    content = path.read_text(encoding="utf-8", errors="replace")
    texts = {html.unescape(double or single) for double, single in QUOTED_TEXT.findall(content)}
    for file in _check_files(texts, folders):
        if file.suffix.lower() == ".xml" and file not in checked:
            _check_files_of(file, folders, checked)


def _check_files(names: Iterable[str], folders: Iterable[Path]) -> list[Path]:
    """Return the regular files with these names, and raise an error for pipes and devices."""
    files = []
    for file in (folder / name for name in names for folder in folders):
        try:
            mode = file.stat().st_mode
        except (OSError, ValueError):  # no such file, or no name of a file
            continue
        if stat.S_ISREG(mode):
            files.append(file)
        elif not stat.S_ISDIR(mode):
            msg = f"{file}: not a regular file"
            raise UnsafeSceneError(msg)
    return files


def _check_plugins(names: Iterable[str], folders: Iterable[Path]) -> None:
    shipped = load_shipped_plugins()
    searched = [*_searched_folders(), *folders]
    for name in dict.fromkeys(names):
        if not PLUGIN_NAME.fullmatch(name):
            msg = f"a plugin's name must be letters, digits and underscores, got {name[:MAX_SHOWN_LENGTH]!r}"
            raise UnsafeSceneError(msg)
        if name in shipped:
            continue
        # Either a type of the parser, a plugin registered in Python, or a library that a scene brings along.
        for folder in searched:
            if any((folder / "plugins" / f"{name}{suffix}").exists() for suffix in LIBRARY_SUFFIXES):
                msg = f"the plugin {name!r} is not Mitsuba's own but a library in {folder / 'plugins'}"
                raise UnsafeSceneError(msg)


@functools.cache
def load_shipped_plugins() -> frozenset[str]:
    """Load all plugins that Mitsuba ships and return their names; Mitsuba then searches no folder for them."""
    package = Path(mi.__file__).parent
    names = frozenset(path.stem for path in (package / "plugins").iterdir() if path.suffix in LIBRARY_SUFFIXES)
    with file_search_path([package]):
        for name in sorted(names):
            mi.PluginManager.instance().plugin_type(name)
    return names
