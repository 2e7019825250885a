"""What fuzzing has found, and what must not come back: one test for each defect."""

from __future__ import annotations

import io
import json
import os
import sys
import threading
import time
import warnings
import zipfile
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import PixelL2, fit
from loi_core.cli import main
from loi_core.errors import FitError, ImageFileError, OptionError, ParameterError, RendererError, SceneError
from loi_core.fitting.checkpoint import load_checkpoint
from loi_core.io.images import read_image
from loi_core.method.scales import ScaleSpace
from loi_core.plugins import registry
from loi_core.renderers import Disks
from loi_core.scenes.experiment import Start
from loi_core.scenes.reading import load_scene
from tests.fuzz.images import _exr_bomb, png_chunk, whole_exr
from tests.fuzz.results import RENDERER, STEPS, TARGET, WHOLE
from tests.fuzz.scenes import SCENE, lay_out, spelled
from tests.helpers import FINISHED

TEXT = spelled(SCENE)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    lay_out(tmp_path)
    (tmp_path / "scene.toml").write_text(TEXT)
    return tmp_path


@pytest.mark.parametrize("number", [0, 2, 4, 8])  # no compression, one without loss, and two with others
def test_an_exr_with_damaged_pixels_is_refused_not_read_as_black(number: int, tmp_path: Path) -> None:
    content = whole_exr(number)
    (tmp_path / "a.exr").write_bytes(content)
    assert read_image(tmp_path / "a.exr").size
    (tmp_path / "a.exr").write_bytes(content[: len(content) * 3 // 4])
    with pytest.raises(ImageFileError, match="not a readable EXR image"):
        read_image(tmp_path / "a.exr")


@pytest.mark.parametrize(
    ("kind", "says"), [("exr part", "pixels are more"), ("exr channels", "its channels take more")]
)
def test_an_exr_is_judged_by_all_its_parts_and_channels(kind: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "a.exr").write_bytes(_exr_bomb(kind, 50000, 50000))
    with pytest.raises(ImageFileError, match=says):
        read_image(tmp_path / "a.exr")


def test_an_npy_of_many_channels_is_refused_before_it_is_read(tmp_path: Path) -> None:
    array = np.lib.format.open_memmap(tmp_path / "a.npy", "w+", np.uint8, (1, 1, 2**34))  # a sparse file
    del array
    with pytest.raises(ImageFileError, match=r"of shape \(H, W\) or \(H, W, 1, 3 or 4\), got uint8"):
        read_image(tmp_path / "a.npy")


def test_what_decoders_warn_of_is_not_said_beside_our_error(tmp_path: Path) -> None:
    header = b"\x00\x00\x32\xc8\x00\x00\x23\x28\x08\x02\x00\x00\x00"  # 13000 x 9000
    chunks = b"".join(png_chunk(kind, data) for kind, data in ((b"IHDR", header), (b"IDAT", b""), (b"IEND", b"")))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(ImageFileError, match="13000 x 9000 pixels"):
            read_image(tmp_path / "a.png")
    assert not caught


def test_names_that_no_file_can_have_are_our_errors(folder: Path) -> None:
    with pytest.raises(ImageFileError, match="File name too long"):
        read_image(folder / ("n" * 300 + ".png"))
    for name in ("loop", "loop/below", "n" * 300):
        with pytest.raises(OptionError, match="`output` must lead to a folder"):
            load_scene(folder / "scene.toml", output=folder / name)


def test_a_pipe_is_not_waited_for(folder: Path) -> None:
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
        ("a" * (9 * 2**20), "larger than 8388608 bytes"),
    ],
    ids=["long key", "long key in quotes", "hexadecimal", "steps", "seed", "size", "large file"],
)
def test_scenes_that_asked_for_too_much_are_refused_at_once(folder: Path, content: str, says: str) -> None:
    (folder / "scene.toml").write_text(content)
    start = time.monotonic()
    with pytest.raises(SceneError, match=says):
        load_scene(folder / "scene.toml")
    assert time.monotonic() - start < 10.0


def test_texts_with_many_dots_are_no_long_keys(folder: Path) -> None:
    dots = "a.b." * 40
    (folder / "scene.toml").write_text(f'title = """{dots}\n= \'" ] {dots}""" # {dots} = [\n{TEXT}')
    assert load_scene(folder / "scene.toml").title.startswith(dots)


def test_whole_numbers_beyond_64_bits_are_numbers(folder: Path) -> None:
    (folder / "scene.toml").write_text(TEXT.replace('"truth" = [[6, 3], [2, 7]]', f"truth = {2**70}"))
    assert load_scene(folder / "scene.toml").truth["positions"].max() == 2.0**70


def test_what_a_dtype_cannot_hold_is_an_error_without_a_warning(folder: Path) -> None:
    (folder / "scene.toml").write_text(TEXT.replace('"initial" = [[2, 3], [4, 4]]', "initial = 1e300"))
    with pytest.raises(SceneError, match="`initial` of 'positions' must be finite"):
        load_scene(folder / "scene.toml")


def test_values_that_cannot_be_printed_are_still_named() -> None:
    with pytest.raises(OptionError, match="`sigma` must be a finite number, 0 or more, got a int that cannot be"):
        ScaleSpace(10**5000, 1, 0.1)


def rewritten(**members: Any) -> bytes:
    """Return the checkpoint with other members: arrays, or bytes as they are."""
    stored = np.load(io.BytesIO(WHOLE))
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        for name in stored.files:
            content = members.get(name.replace("/", "_"), stored[name])
            member = io.BytesIO()
            np.save(member, content)
            file.writestr(f"{name}.npy", content if isinstance(content, bytes) else member.getvalue())
    return stream.getvalue()


def resume_from(file: Path) -> Any:
    return fit(RENDERER, PixelL2(TARGET), steps=STEPS, learning_rate=0.1, checkpoint=file, resume=True)


@pytest.mark.parametrize(
    ("members", "says"),
    [
        ({"params_positions": b"no array"}, "is not a checkpoint of a fit"),
        ({"params_positions": np.zeros((3, 2))}, "`checkpoint` holds other parameters than this fit has"),
        ({"memory_second_positions": np.full((1, 2), -1.0)}, "'second/positions' are not numbers of a fit"),
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


def test_a_damaged_history_is_no_reason_not_to_resume(folder: Path) -> None:
    assert main(["fit", str(folder / "scene.toml")]) in FINISHED
    history = folder / "scene-result" / "history.csv"
    history.write_text(f"step,value,psnr\n0,{'9' * 200_000},1\n")  # more than the csv module takes
    assert main(["fit", str(folder / "scene.toml"), "--resume"]) in FINISHED


def test_a_report_shows_whatever_numbers_and_texts_a_result_has(tmp_path: Path) -> None:
    trial = {"objective": "loi", "psnr": 10**400, "best_step": 10**400, "seconds": True}
    result = {"title": "\ud800 é", "scene": "s", "steps": 1, "trials": [trial]}
    (tmp_path / "result.json").write_text(json.dumps(result))
    assert main(["report", str(tmp_path)]) == 0
    assert "<title>? é</title>" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("arguments", [[], ["fly"], ["fit"], ["fit", "a", "b"], ["tradeoff", "--seconds", "soon"]])
def test_a_wrong_call_is_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("loi: ")
    assert said.count("\n") == 1
    assert "--help`" in said


def test_a_terminal_is_not_sent_what_a_file_holds(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "scene.toml").write_text('"\\u001b[2J\\u202e" = 1\n' + TEXT)
    assert main(["fit", str(folder / "scene.toml")]) == 2
    assert "unknown key `\\x1b[2J\\u202e`" in capsys.readouterr().err


def test_an_answer_that_the_terminal_has_no_letters_for_is_escaped(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "scene.toml").write_text('title = "Käfer"\n' + TEXT, encoding="utf-8")
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", out)
    assert main(["fit", str(folder / "scene.toml")]) in FINISHED
    out.flush()
    assert b"K\\xe4fer" in out.buffer.getvalue()


ODD = """
class Own(BaseException): pass
class OwnInterrupt(KeyboardInterrupt): pass
class Mute(Exception):
    def __str__(self): raise RuntimeError('mute')
class Touchy:
    def __getattr__(self, name): raise RuntimeError(name)
    def __call__(self, **options): return None
def __getattr__(name):
    if name == 'touchy': return Touchy()
    raise {'own': Own, 'interrupt': OwnInterrupt, 'mute': Mute}[name]
"""


def test_whatever_a_plugin_raises_it_is_listed_as_broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plugin_that_is_odd.py").write_text(ODD)
    monkeypatch.syspath_prepend(str(tmp_path))
    values = {name: f"plugin_that_is_odd:{name}" for name in ("own", "interrupt", "mute", "touchy")}
    values |= {"no value": "not a module!!", "nothing": ""}
    points = [EntryPoint(name, value, registry.RENDERERS.name) for name, value in values.items()]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    listed = {one.name: one for one in registry.available_renderers()}
    assert {name: one.state for name, one in listed.items()} == dict.fromkeys(values, "broken")
    assert listed["own"].problem == "Own"
    assert listed["mute"].problem == "Mute: its message cannot be printed"
    assert listed["no value"].problem == "'not a module!!' is not a module and an object in it"


def test_what_a_plugin_prints_is_not_part_of_the_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plugin_that_greets.py").write_text("print('hello')\nmake = dict\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [EntryPoint("greets", "plugin_that_greets:make", registry.RENDERERS.name)]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    assert main(["renderers", "--json"]) == 0
    out, err = capsys.readouterr()
    assert [one["state"] for one in json.loads(out)] == ["ready"]
    assert err == "hello\n"


@pytest.mark.parametrize("content", [b"[loi.renderers]\nno equals sign\n", b"\xff"], ids=["syntax", "encoding"])
def test_a_package_with_damaged_metadata_does_not_hide_the_others(
    content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "damaged-1.0.dist-info").mkdir()
    (tmp_path / "damaged-1.0.dist-info" / "entry_points.txt").write_bytes(content)
    (tmp_path / "damaged-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: damaged\nVersion: 1.0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    states = {one.name: one.state for one in registry.available_renderers()}
    assert states["damaged"] == "broken"
    assert states["disks"] == "ready"
    assert registry.load_renderer("disks") is Disks


class Fragile(Disks):
    """Raises what no handler of ordinary errors catches."""

    calls = 0

    def render_vjp(self, params: Any, *, seed: int = 0) -> Any:
        self.calls += 1
        if self.calls == 3:
            raise SystemExit(0)
        return super().render_vjp(params, seed=seed)


def test_a_renderer_that_wants_to_end_the_process_does_not_take_the_fit_with_it() -> None:
    renderer = Fragile(6, 6, [[2.0, 3.0]], [1.5], [[0.9, 0.2, 0.1]])
    with pytest.raises(FitError, match="step 2: rendering failed: SystemExit: 0") as caught:
        fit(renderer, PixelL2(TARGET), steps=5, learning_rate=0.1)
    assert caught.value.result is not None


class Empty:
    def parameters(self) -> Any:
        raise SystemExit(0)

    def render(self, params: Any, *, seed: int = 0) -> Any: ...

    def render_vjp(self, params: Any, *, seed: int = 0) -> Any: ...


class Late(Empty):
    def parameters(self) -> Any:
        return {"positions": np.zeros((2, 2))}

    def render(self, params: Any, *, seed: int = 0) -> Any:
        raise SystemExit(0)


@pytest.mark.parametrize(
    ("made", "error", "says"),
    [
        (lambda: None, SceneError, "foreign made a NoneType, which is not a renderer"),
        (lambda: sys.exit(0), SceneError, "foreign refused: SystemExit: 0"),
        (Empty, RendererError, r"Empty.parameters\(\) failed: SystemExit: 0"),
        (Late, RendererError, "rendering the start failed: SystemExit: 0"),
    ],
)
def test_a_renderer_of_others_fails_in_one_line(
    made: Any, error: type[Exception], says: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = {**SCENE, "renderer": {"name": "foreign"}, "optimise": {"positions": {}}}
    (folder / "scene.toml").write_text(spelled(document))
    monkeypatch.setattr("loi_core.scenes.making.load_renderer", lambda name: lambda: made())
    with pytest.raises(error, match=says):
        Start.of(load_scene(folder / "scene.toml"))


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


def test_moments_that_overflow_end_the_fit_with_an_error_and_no_warning(tmp_path: Path) -> None:
    moments: dict[str, Any] = {
        "memory_first_positions": np.full((1, 2), 1e308),
        "memory_second_positions": np.zeros((1, 2)),
    }
    (tmp_path / "state.npz").write_bytes(rewritten(**moments))
    with pytest.raises(FitError, match="`positions` must be finite"):
        resume_from(tmp_path / "state.npz")


def test_a_radius_without_a_square_covers_all_without_a_warning() -> None:
    renderer = Disks(6, 6, [[2.0, 3.0]], [1e300], [[0.9, 0.2, 0.1]])
    np.testing.assert_array_equal(renderer.render(renderer.parameters()), np.broadcast_to([0.9, 0.2, 0.1], (6, 6, 3)))
