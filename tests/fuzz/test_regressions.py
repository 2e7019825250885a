"""One test for each defect that fuzzing has revealed."""

from __future__ import annotations

import io
import json
import os
import sys
import threading
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from loi_core.cli import main
from loi_core.errors import FitError, ImageFileError, OptionError, ParameterError, SceneError
from loi_core.fitting.checkpoint import load_checkpoint
from loi_core.io.images import read_image
from loi_core.method.scales import ScaleSpace
from loi_core.renderers import Disks
from loi_core.scenes.reading import load_scene
from tests.fuzz.images import exr_with_window, png_chunk, whole_exr
from tests.fuzz.results import STEPS, resume_from, rewritten
from tests.fuzz.scenes import SCENE, lay_out, to_toml
from tests.helpers import FINISHED

TEXT = to_toml(SCENE)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    lay_out(tmp_path)
    (tmp_path / "scene.toml").write_text(TEXT)
    return tmp_path


@pytest.mark.parametrize("number", range(10))  # every compression
def test_an_exr_with_missing_pixels_is_refused(number: int, tmp_path: Path) -> None:
    content = whole_exr(number)
    (tmp_path / "a.exr").write_bytes(content)
    assert read_image(tmp_path / "a.exr").size
    (tmp_path / "a.exr").write_bytes(content[: len(content) * 3 // 4])
    with pytest.raises(ImageFileError, match="not a readable EXR image"):
        read_image(tmp_path / "a.exr")


def test_an_exr_of_too_many_pixels_or_channels_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    (tmp_path / "a.exr").write_bytes(exr_with_window(whole_exr(0), 50000, 50000))
    with pytest.raises(ImageFileError, match="50000 x 50000 pixels are more than"):
        read_image(tmp_path / "a.exr")
    channels = {f"c{number}": np.zeros((4, 4), np.float32) for number in range(40)}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(tmp_path / "whole.exr"))
    (tmp_path / "a.exr").write_bytes(exr_with_window((tmp_path / "whole.exr").read_bytes(), 8000, 8000))
    with pytest.raises(ImageFileError, match="its channels take more than"):
        read_image(tmp_path / "a.exr")


def test_an_npy_of_many_channels_is_refused_before_it_is_read(tmp_path: Path) -> None:
    array = np.lib.format.open_memmap(tmp_path / "a.npy", "w+", np.uint8, (1, 1, 2**34))  # a sparse file
    del array
    with pytest.raises(ImageFileError, match=r"of shape \(H, W\) or \(H, W, 1, 3 or 4\), got uint8"):
        read_image(tmp_path / "a.npy")


@pytest.mark.parametrize("dtype", ["|V0", "|S0", "<U0", "|O"])
def test_an_npy_of_elements_without_size_does_not_end_the_process(dtype: str, tmp_path: Path) -> None:
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({2**62}, {2**62}, 3)}}".encode()
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(ImageFileError, match=r"an NPY image must be|not a readable NPY image"):
        read_image(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "state.npz", "w") as file:
        file.write(tmp_path / "a.npy", "state.npy")
    with pytest.raises(ParameterError, match="is not a checkpoint"):
        load_checkpoint(tmp_path / "state.npz", {})


def test_warnings_of_decoders_are_not_shown_beside_our_error(tmp_path: Path) -> None:
    header = b"\x00\x00\x32\xc8\x00\x00\x23\x28\x08\x02\x00\x00\x00"  # 13000 x 9000
    chunks = b"".join(png_chunk(name, data) for name, data in ((b"IHDR", header), (b"IDAT", b""), (b"IEND", b"")))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ImageFileError, match="13000 x 9000 pixels"):
            read_image(tmp_path / "a.png")


def test_names_that_no_file_can_have_are_our_errors(folder: Path) -> None:
    with pytest.raises(ImageFileError, match="File name too long"):
        read_image(folder / ("n" * 300 + ".png"))
    for name in ("loop", "loop/below", "n" * 300):
        with pytest.raises(OptionError, match="`output` must lead to a folder"):
            load_scene(folder / "scene.toml", output=folder / name)


def test_pipes_are_refused_at_once(folder: Path) -> None:
    for name in ("pipe.toml", "out/checkpoint.npz", "out/result.json", "out/history.csv"):
        (folder / name).parent.mkdir(exist_ok=True)
        os.mkfifo(folder / name)
    codes: list[int] = []

    def call() -> None:
        codes.append(main(["fit", str(folder / "pipe.toml")]))
        codes.append(main(["report", str(folder / "out")]))
        codes.append(main(["fit", str(folder / "scene.toml"), "--output", str(folder / "out"), "--resume"]))

    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(60.0)
    assert codes == [2, 2, 2]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (f"target{'.a' * 20000} = 1\n" + TEXT, "keys may have at most 32 parts"),
        (f"fit = {{ {chr(34) + '=' + chr(34) + '.'}{'a . ' * 40}a = 1 }}\n", "keys may have at most 32 parts"),
        (TEXT.replace('"sigma" = 1', f"sigma = 0x{'f' * 9000}"), "`sigma` must be a finite number, 0 or more, got a"),
        (TEXT.replace('"steps" = 2', "steps = 1" + "0" * 400), "`steps` must be a whole number, at most 2147483647"),
        (TEXT.replace('"steps" = 2', f"seed = {2**64}"), "`seed` must be a whole number, at most 9223372036854775807"),
        (TEXT.replace('"disks"', '"disks"\nheight = 1000000'), "`height` must be that of the target, 10, got 1000000"),
        (TEXT.replace('"initial" = [[2, 3], [4, 4]]', "initial = 1e300"), "`initial` of 'positions' must be finite"),
        ("a" * (9 * 2**20), "larger than 8388608 bytes"),
    ],
    ids=["long key", "long key in quotes", "hexadecimal", "steps", "seed", "size", "overflow", "large file"],
)
def test_scene_files_with_huge_values_are_refused(folder: Path, content: str, says: str) -> None:
    (folder / "scene.toml").write_text(content)
    with pytest.raises(SceneError, match=says):
        load_scene(folder / "scene.toml")


def test_strings_and_comments_with_many_dots_are_no_long_keys(folder: Path) -> None:
    dots = "a.b." * 40
    (folder / "scene.toml").write_text(f'title = """{dots}\n= \'" ] {dots}""" # {dots} = [\n{TEXT}')
    assert load_scene(folder / "scene.toml").title.startswith(dots)


def test_whole_numbers_beyond_64_bits_are_numbers(folder: Path) -> None:
    (folder / "scene.toml").write_text(TEXT.replace('"truth" = [[6, 3], [2, 7]]', f"truth = {2**70}"))
    assert load_scene(folder / "scene.toml").truth["positions"].max() == 2.0**70


def test_values_that_cannot_be_printed_are_still_named() -> None:
    with pytest.raises(OptionError, match="`sigma` must be a finite number, 0 or more, got a int that cannot be"):
        ScaleSpace(10**5000, 1, 0.1)


@pytest.mark.parametrize(
    ("members", "says"),
    [
        ({"params__positions": b"no array"}, "is not a checkpoint of a fit"),
        ({"params__positions": np.zeros((3, 2))}, "`checkpoint` holds other parameters than this fit has"),
        ({"memory__second__positions": np.full((1, 2), -1.0)}, "'second/positions' are not numbers of a fit"),
        ({"history": np.zeros((2, 12))}, "its counts of steps disagree"),
        ({"state": np.array("[" * 100_000)}, "is not a checkpoint of a fit"),
        ({"state": np.array("{}")}, "is not a checkpoint of a fit"),
    ],
    ids=["bytes", "shape", "negative square", "history", "nest", "empty"],
)
def test_a_checkpoint_with_foreign_members_is_refused(members: dict[str, Any], says: str, tmp_path: Path) -> None:
    (tmp_path / "state.npz").write_bytes(rewritten())
    assert len(resume_from(tmp_path / "state.npz").history) == STEPS
    (tmp_path / "state.npz").write_bytes(rewritten(**members))
    with pytest.raises(ParameterError, match=says):
        resume_from(tmp_path / "state.npz")


def test_moments_that_overflow_end_the_fit_with_an_error_and_no_warning(tmp_path: Path) -> None:
    moments: dict[str, Any] = {
        "memory__first__positions": np.full((1, 2), 1e308),
        "memory__second__positions": np.zeros((1, 2)),
    }
    (tmp_path / "state.npz").write_bytes(rewritten(**moments))
    with pytest.raises(FitError, match="`positions` must be finite"):
        resume_from(tmp_path / "state.npz")


def test_a_damaged_history_does_not_prevent_resuming(folder: Path) -> None:
    assert main(["fit", str(folder / "scene.toml")]) in FINISHED
    history = folder / "scene-result" / "history.csv"
    history.write_text(f"step,value,psnr\n0,{'9' * 200_000},1\n")  # more than the csv module takes
    assert main(["fit", str(folder / "scene.toml"), "--resume"]) in FINISHED


def test_a_report_shows_any_numbers_and_texts_of_a_result(tmp_path: Path) -> None:
    trial = {"objective": "loi", "psnr": 10**400, "best_step": 10**400, "seconds": True}
    result = {"title": "\ud800 é", "scene": "s", "steps": 1, "trials": [trial]}
    (tmp_path / "result.json").write_text(json.dumps(result))
    assert main(["report", str(tmp_path)]) == 0
    assert "<title>? é</title>" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("arguments", [[], ["fly"], ["fit"], ["fit", "a", "b"], ["tradeoff", "--seconds", "soon"]])
def test_a_wrong_command_line_gives_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    message = capsys.readouterr().err
    assert message.startswith("loi: ")
    assert message.count("\n") == 1
    assert "--help`" in message


def test_control_characters_of_a_file_are_escaped_in_messages(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "scene.toml").write_text('"\\u001b[2J\\u202e" = 1\n' + TEXT)
    assert main(["fit", str(folder / "scene.toml")]) == 2
    assert "unknown key `\\x1b[2J\\u202e`" in capsys.readouterr().err


def test_letters_that_the_terminal_lacks_are_escaped(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "scene.toml").write_text('title = "Käfer"\n' + TEXT, encoding="utf-8")
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", out)
    assert main(["fit", str(folder / "scene.toml")]) in FINISHED
    out.flush()
    assert b"K\\xe4fer" in out.buffer.getvalue()


def test_a_radius_whose_square_overflows_covers_everything_without_a_warning() -> None:
    renderer = Disks(6, 6, [[2.0, 3.0]], [1e300], [[0.9, 0.2, 0.1]])
    np.testing.assert_array_equal(renderer.render(renderer.parameters()), np.broadcast_to([0.9, 0.2, 0.1], (6, 6, 3)))
