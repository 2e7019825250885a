"""Result folders for tests of pages."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from loi_core.cli import main
from tests.helpers import FINISHED
from tests.one_disk import DISK_TO_FIND, lay_out_disk

SCENE = f"""\
title = "One disk"
target = "target.png"
output = "result"

{DISK_TO_FIND}
[objective]
compare = ["pixel_l2"]

[fit]
steps = 60
"""


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return lay_out_disk(tmp_path_factory.mktemp("scene"), SCENE)


@pytest.fixture(scope="session")
def fitted(scene: Path) -> Path:
    """The folder of a fit, which tests must not change: see `copied`."""
    assert main(["fit", str(scene), "--steps", "60"]) in FINISHED
    return scene.parent / "result"


@pytest.fixture
def copied(fitted: Path, tmp_path: Path) -> Path:
    return shutil.copytree(fitted, tmp_path / "result")
