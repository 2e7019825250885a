"""A fit writes only to folders that are empty or that a fit has marked."""

from __future__ import annotations

import base64
import json
import os
from pathlib import Path

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.io.files import remove_temporaries
from loi_core.io.images import write_png
from loi_core.io.result_folder import MARKER_FILE, ResultFolder
from loi_core.renderers import Disks
from tests.helpers import FINISHED

SCENE = """\
target = "target.png"
output = "result"
title = "a\\u001b[31m red \\u202e title"

[renderer]
name = "disks"
positions = [[10, 6]]
radii = [3]
colours = [[0.9, 0.2, 0.1]]

[optimise.positions]
initial = [[4, 12]]

[objective]
compare = ["pixel_l2"]

[fit]
steps = 3
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    disks = Disks(16, 16, [[10, 6]], 3.0, [[0.9, 0.2, 0.1]])
    write_png(tmp_path / "target.png", disks.render(disks.parameters()))
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def assets(folder: Path) -> Path:
    """Return a folder with pictures that have the names of a fit's files."""
    for name in ("frames/000000.png", "frames/000001.png", "effects/shadows.png", "final.png", "note.txt"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"mine")
    return folder


def test_a_foreign_folder_is_refused_and_unchanged(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = assets(tmp_path / "assets")
    content = contents(foreign)
    assert main(["fit", str(scene), "--output", str(foreign)]) == 2
    assert "new or empty folder" in capsys.readouterr().err
    assert contents(foreign) == content


def test_files_that_a_user_adds_to_a_folder_of_results_stay(scene: Path) -> None:
    assert main(["fit", str(scene)]) in FINISHED
    names = ("frames/000777.png", "frames/mine.png", "gradients/mine.png", "effects/mine.png", "note.txt")
    for name in names:
        (scene.parent / "result" / name).parent.mkdir(exist_ok=True)
        (scene.parent / "result" / name).write_bytes(b"mine")
    assert main(["fit", str(scene)]) in FINISHED
    assert all((scene.parent / "result" / name).read_bytes() == b"mine" for name in names)


def test_the_marker_lists_every_picture_of_a_fit(scene: Path) -> None:
    assert main(["fit", str(scene)]) in FINISHED
    result = scene.parent / "result"
    listed = set(json.loads((result / MARKER_FILE).read_text())["files"])
    assert {name for name in contents(result) if name.endswith(".png")} <= listed


def test_unfinished_copies_of_listed_files_are_removed_and_others_stay(tmp_path: Path) -> None:
    folder = ResultFolder(tmp_path / "result")
    folder.file("frames/000001.png")
    mine = ["mine.png", "frames/.loi-unfinished-000002-abcdefgh.png", "frames/.loi-unfinished-000001.png"]
    for name in (*mine, ".loi-unfinished-loi-fit-abcdefgh.json", "frames/.loi-unfinished-000001-ab_def12.png"):
        (folder.path / name).parent.mkdir(exist_ok=True)
        (folder.path / name).write_bytes(b"half")
    folder.remove_unfinished()
    assert set(contents(folder.path)) == {MARKER_FILE, *mine}


@pytest.mark.parametrize("listed", ["../outside.png", "/outside.png", "frames/../../outside.png", 3])
def test_a_marker_that_lists_files_outside_removes_nothing(listed: object, tmp_path: Path) -> None:
    outside = tmp_path / "outside.png"
    outside.write_bytes(b"mine")
    (tmp_path / "result" / "frames").mkdir(parents=True)
    (tmp_path / "result" / MARKER_FILE).write_text(json.dumps({"files": [listed]}))
    folder = ResultFolder(tmp_path / "result")
    folder.remove([str(listed)])
    assert folder.pictures("frames") == []
    assert outside.read_bytes() == b"mine"


@pytest.mark.parametrize("name", ["frames", "compare"])
def test_a_fit_writes_and_removes_nothing_through_a_link(
    name: str, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fit", str(scene)]) in FINISHED
    inside, outside = scene.parent / "result" / name, tmp_path / "elsewhere"
    inside.rename(outside)
    inside.symlink_to(outside, target_is_directory=True)
    content = contents(outside)
    assert main(["fit", str(scene)]) == 2
    assert "is a link" in capsys.readouterr().err
    assert contents(outside) == content


@pytest.mark.parametrize("output", ["../x", "a/../../x", "/x", "linked"])
def test_the_output_of_a_scene_lies_in_its_folder(
    output: str, scene: Path, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    (scene.parent / "linked").symlink_to(tmp_path_factory.mktemp("outside"), target_is_directory=True)
    scene.write_text(SCENE.replace('"result"', f'"{output}"'))
    assert main(["fit", str(scene)]) == 2
    assert "must lie in the folder of the scene" in capsys.readouterr().err


def test_a_fit_killed_before_its_first_result_can_be_resumed(scene: Path) -> None:
    result = scene.parent / "result"
    assert main(["fit", str(scene)]) in FINISHED
    checkpoint = (result / "checkpoint.npz").read_bytes()
    for path in sorted(result.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    left = result / ".loi-unfinished-checkpoint-a1b2c3d4.npz"
    left.write_bytes(b"half")
    ResultFolder(result).claim()
    (result / "checkpoint.npz").write_bytes(checkpoint)
    assert main(["fit", str(scene), "--resume"]) in FINISHED
    assert not left.exists()


def test_the_folder_is_marked_before_the_checkpoint_is_written(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    marked = []
    monkeypatch.setattr(
        "loi_core.fitting.checkpoint.save_checkpoint",
        lambda path, *_: marked.append((path.parent / MARKER_FILE).exists()),
    )
    assert main(["fit", str(scene)]) in FINISHED
    assert marked == [True]


def test_a_folder_that_only_holds_a_foreign_checkpoint_is_refused(scene: Path, tmp_path: Path) -> None:
    foreign = tmp_path / "models"
    foreign.mkdir()
    (foreign / "checkpoint.npz").write_bytes(b"mine")
    (foreign / ".checkpoint-20251122.npz").write_bytes(b"mine")
    content = contents(foreign)
    assert main(["fit", str(scene), "--output", str(foreign)]) == 2
    assert contents(foreign) == content


def test_a_foreign_report_is_not_replaced(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", str(scene)]) in FINISHED
    result = scene.parent / "result"
    (result / MARKER_FILE).unlink()
    (result / "report.html").write_text("mine")
    assert main(["report", str(result)]) == 2
    assert "was not written by `loi`" in capsys.readouterr().err
    assert (result / "report.html").read_text() == "mine"


def test_only_temporaries_of_the_file_itself_are_removed(tmp_path: Path) -> None:
    begin = ".loi-unfinished-"
    names = (f"{begin}a-abcdefgh.npz", f"{begin}a-abc.npz", f"{begin}ab-abcdefgh.npz", "a.npz", ".a-20251122.npz")
    for name in names:
        (tmp_path / name).write_bytes(b"")
    remove_temporaries(tmp_path / "a.npz")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])


def test_control_characters_in_titles_and_paths_are_escaped(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = scene.parent / "out\x1b[2J"
    assert main(["fit", str(scene), "--output", str(folder)]) in FINISHED
    assert main(["report", str(folder)]) == 0
    printed = capsys.readouterr()
    assert all(letter.isprintable() or letter == "\n" for letter in printed.out)
    assert "\\x1b[31m red \\u202e title" in printed.out


def secret_page(folder: Path) -> str:
    main(["report", str(folder)])
    return (folder / "report.html").read_text() if (folder / "report.html").exists() else ""


def test_a_report_shows_no_files_of_other_folders(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_png(tmp_path / "secret.png", np.full((2, 2, 3), 0.123))
    hidden = (tmp_path / "secret.png").read_bytes()
    assert main(["fit", str(scene)]) in FINISHED
    result = scene.parent / "result"
    summary = json.loads((result / "result.json").read_text())
    summary |= {"plan": "p", "effects": {"../../secret": True, "/etc/x": True, "..": True}}
    (result / "result.json").write_text(json.dumps(summary))
    assert base64.b64encode(hidden).decode() not in secret_page(result)
    (result / "final.png").unlink()
    (result / "final.png").symlink_to(tmp_path / "secret.png")
    (result / "report.html").unlink()
    capsys.readouterr()
    assert main(["report", str(result)]) == 2
    assert "final.png is a link" in capsys.readouterr().err
    assert not (result / "report.html").exists()


def test_a_report_refuses_pictures_of_gigabytes(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", str(scene)]) in FINISHED
    picture = scene.parent / "result" / "target.png"
    os.truncate(picture, 3 * 2**30)  # sparse: it takes no room
    assert main(["report", str(picture.parent)]) == 2
    assert "too large" in capsys.readouterr().err
