"""The package `loi` gathers the public names of all packages, and imports them when they are used."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Final

import pytest

import loi
import loi_core
from tests.environments import run
from tests.public_names import PACKAGES

PACKAGES_OF_NAMESPACE: Final = [name for name in PACKAGES if name != "mitsuba_boundaries"]


@pytest.mark.parametrize("package", [*PACKAGES_OF_NAMESPACE, "loi_core.renderers", "loi_core.errors"])
def test_a_module_of_the_namespace_has_the_objects_of_its_package(package: str) -> None:
    original = pytest.importorskip(package)
    module = importlib.import_module(package.replace("loi_core", "loi").replace("loi_", "loi.", 1))
    assert list(module.__all__) == list(original.__all__)
    for name in original.__all__:
        assert getattr(module, name) is getattr(original, name)


def test_all_public_names_are_listed() -> None:
    assert set(dir(loi)) == {*loi_core.__all__, *loi._MODULES}
    assert all(getattr(loi, module).__name__ == f"loi.{module}" for module in ("errors", "renderers"))


def test_importing_the_namespace_imports_neither_numpy_nor_a_framework() -> None:
    names = ("numpy", "loi_core", "torch", "jax", "mitsuba", "kornia", "trimesh")
    code = f"import sys, loi; print([name for name in {names!r} if name in sys.modules])"
    assert run(sys.executable, "-c", code).strip() == "[]"


def test_a_wrong_name_is_an_attribute_error_with_a_guess() -> None:
    with pytest.raises(AssertionError, match=r"has no attribute 'LOIObjectiv'. Did you mean: 'LOIObjective'\?"):
        run(sys.executable, "-c", "from loi import *; import loi; assert LOIObjective; loi.LOIObjectiv")
    assert not hasattr(loi, "nonsense")


@pytest.mark.parametrize(
    ("absent", "extra", "statement"),
    [
        ("torch", "torch", "import loi.torch"),
        ("jax", "jax", "import loi; loi.jax"),
        ("mitsuba", "mitsuba", "from loi.mitsuba import loi_loss"),
        ("trimesh", "mesh", "import loi.torch.mesh"),
        ("svgelements", "svg", "import loi.torch.vector"),
    ],
)
def test_a_missing_framework_is_named_with_its_extra(absent: str, extra: str, statement: str) -> None:
    if statement.startswith("import loi.torch."):
        pytest.importorskip("torch")
    hidden = f"import sys; sys.modules[{absent!r}] = None\n"  # as if it were not installed
    message = rf"ModuleNotFoundError: the package {absent} is not installed: .*\[{extra}\]"
    with pytest.raises(AssertionError, match=message):
        run(sys.executable, "-c", hidden + statement)


FOLDER_ALONE = """
import sys
from importlib.machinery import PathFinder

class OnlyTheFolder(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return PathFinder.find_spec(name, [sys.argv[1]]) if name == sys.argv[2] else None

sys.meta_path.insert(0, OnlyTheFolder)
"""


@pytest.mark.parametrize("name", ["torch", "jax", "mitsuba"])
def test_a_folder_with_the_name_of_a_missing_framework_is_not_the_framework(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    message = rf"ModuleNotFoundError: the package {name} is not installed: .*\[{name}\]"
    with pytest.raises(AssertionError, match=message):
        run(sys.executable, "-c", f"{FOLDER_ALONE}import loi.{name}", str(tmp_path), name)


def test_the_loss_of_mitsuba_uses_numpy_beside_a_folder_with_the_name_of_a_missing_torch(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    (tmp_path / "torch").mkdir()
    code = f"""{FOLDER_ALONE}
import loi_mitsuba
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
image = mi.TensorXf([0.5] * 192, (8, 8, 3))
print(float(loi_mitsuba.loi_loss(image, image)[0]))
"""
    assert run(sys.executable, "-c", code, str(tmp_path), "torch").strip() == "0.0"


def test_the_namespace_is_also_the_command() -> None:
    assert run(sys.executable, "-m", "loi", "--version").strip().endswith(loi_core.__version__)
