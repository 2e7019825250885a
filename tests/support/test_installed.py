"""The command in errors about missing packages installs them."""

from __future__ import annotations

import importlib.metadata
import json
import shlex
from pathlib import Path

import pytest

from loi_core.support.installed import how_to_install


class Installed:
    """A distribution as pip installs it."""

    def __init__(self, origin: str | None) -> None:
        self._origin = origin

    def read_text(self, name: str) -> str | None:
        return self._origin if name == "direct_url.json" else None


@pytest.mark.parametrize(
    "origin",
    [None, "", "{}", "[]", "torn {", '{"url": "file:///nowhere", "dir_info": {"editable": true}}',
     '{"url": "file:///tmp", "dir_info": {}}', '{"dir_info": {"editable": true}}'],
)  # fmt: skip
def test_an_extra_of_a_package_without_a_clone_comes_from_an_index(
    origin: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.metadata, "distribution", lambda _: Installed(origin))
    assert how_to_install("jax") == "pip install 'loi[jax]'"


@pytest.mark.parametrize("name", ["clone", "a folder with 'quotes'"])
def test_an_extra_of_a_clone_comes_from_the_clone_with_its_versions(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clone = tmp_path / name
    clone.mkdir()
    origin = json.dumps({"url": clone.as_uri(), "dir_info": {"editable": True}})
    monkeypatch.setattr(importlib.metadata, "distribution", lambda _: Installed(origin))
    assert shlex.split(how_to_install("jax")) == ["pip", "install", "-e", f"{clone}[jax]"]
    (clone / "constraints.txt").touch()
    expected = ["pip", "install", "-c", f"{clone}/constraints.txt", "-e", f"{clone}[jax]"]
    assert shlex.split(how_to_install("jax")) == expected


def test_an_extra_of_a_package_that_is_not_installed_comes_from_an_index() -> None:
    assert how_to_install("more", "no-such-package") == "pip install 'no-such-package[more]'"
