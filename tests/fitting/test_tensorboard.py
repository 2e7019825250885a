"""What a fit writes for TensorBoard, read back from the file, and written by whatever has the methods."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core import LOIObjective, TensorBoardCallback
from loi_core.errors import OptionError
from tests.fitting.fits import REFERENCE, SCALES, run
from tests.frameworks import torch

OBJECTIVE = LOIObjective(REFERENCE, SCALES)


class Writer:
    """One that keeps what it is given, and is of no framework."""

    def __init__(self) -> None:
        self.scalars: dict[str, list[tuple[int, float]]] = {}
        self.images: dict[str, list[tuple[int, Any]]] = {}
        self.texts: dict[str, str] = {}

    def add_scalar(self, tag: str, scalar_value: Any, global_step: Any = None) -> None:
        self.scalars.setdefault(tag, []).append((global_step, scalar_value))

    def add_image(self, tag: str, img_tensor: Any, global_step: Any = None, *, dataformats: str = "CHW") -> None:
        assert dataformats == "HWC"
        self.images.setdefault(tag, []).append((global_step, img_tensor))

    def add_text(self, tag: str, text_string: str, global_step: Any = None) -> None:
        self.texts[tag] = text_string


@pytest.fixture(scope="module")
def fitted() -> tuple[Writer, Any]:
    writer = Writer()
    board = TensorBoardCallback(writer, OBJECTIVE, every=10)
    result = run(steps=25, callback=board)
    board.result(result)
    return writer, result


def test_each_step_writes_its_value_gradient_rate_stage_and_parameters(fitted: tuple[Writer, Any]) -> None:
    writer, result = fitted
    assert writer.scalars["fit/value"] == [(one.step, one.value) for one in result.history]
    assert writer.scalars["fit/gradient norm"] == [(one.step, one.gradient_norm) for one in result.history]
    assert writer.scalars["fit/rate"] == [(one.step, one.rate) for one in result.history]
    assert writer.scalars["fit/stage"] == [(one.step, float(one.stage)) for one in result.history]
    positions = [(one.step, float(one.params["positions"][0, 1])) for one in result.history]
    assert writer.scalars["parameters/positions[0][1]"] == positions


def test_now_and_then_the_image_is_written_and_the_reference_once(fitted: tuple[Writer, Any]) -> None:
    writer, result = fitted
    assert [step for step, _ in writer.images["image"]] == [0, 10, 20]
    assert [step for step, _ in writer.images["found"]] == [result.best_step]
    (only,) = writer.images["reference"]
    np.testing.assert_array_equal(only[1], REFERENCE)
    np.testing.assert_array_equal(writer.images["found"][0][1], result.image)


def test_the_shares_of_the_scales_sum_to_the_value(fitted: tuple[Writer, Any]) -> None:
    writer, result = fitted
    shares = {tag: dict(points) for tag, points in writer.scalars.items() if tag.startswith("scales/")}
    assert list(shares) == ["scales/sigma 1, alpha 3, beta 0.125", "scales/sigma 1, alpha 9, beta 0.125"]
    for step in (0, 10, 20):
        value = result.history[step].value
        assert sum(points[step] for points in shares.values()) == pytest.approx(value, rel=1e-9)


def test_the_verdict_and_what_was_found_are_a_text(fitted: tuple[Writer, Any]) -> None:
    writer, result = fitted
    assert str(result.diagnosis) in writer.texts["verdict"]
    assert "positions: " in writer.texts["verdict"]
    assert f"{result.psnr:.2f} dB" in writer.texts["verdict"]


def test_a_fit_goes_the_same_way_with_it(fitted: tuple[Writer, Any]) -> None:
    alone = run(steps=25)
    np.testing.assert_array_equal(alone.params["positions"], fitted[1].params["positions"])


def test_an_event_file_holds_what_was_written(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    pytest.importorskip("torch")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from torch.utils.tensorboard import SummaryWriter

    with SummaryWriter(str(tmp_path)) as writer:
        board = TensorBoardCallback(writer, OBJECTIVE, every=10)
        result = run(steps=12, callback=board)
        board.result(result)
    events = EventAccumulator(str(tmp_path), size_guidance={"scalars": 0, "images": 0, "tensors": 0})
    events.Reload()
    values = [one.value for one in events.Scalars("fit/value")]
    np.testing.assert_allclose(values, [one.value for one in result.history], rtol=1e-6)
    assert [one.step for one in events.Images("image")] == [0, 10]
    picture = events.Images("reference")[0]
    assert (picture.height, picture.width) == REFERENCE.shape[:2]
    (text,) = events.Tensors("verdict/text_summary")
    assert str(result.diagnosis).encode() in text.tensor_proto.string_val[0]


def test_a_loop_of_one_s_own_writes_tensors_that_record_gradients() -> None:
    writer = Writer()
    board = TensorBoardCallback(writer, OBJECTIVE, every=2)
    image = torch.tensor(REFERENCE * 0.5, requires_grad=True)
    for step in range(3):
        board.step(step, (image**2).mean(), image, params={"exposure": torch.tensor(0.5)}, temperature=step / 2)
    assert [step for step, _ in writer.images["image"]] == [0, 2]
    assert writer.scalars["parameters/exposure"] == [(0, 0.5), (1, 0.5), (2, 0.5)]
    assert writer.scalars["fit/temperature"] == [(0, 0.0), (1, 0.5), (2, 1.0)]


def test_many_parameters_are_no_curves_and_views_have_pictures_of_their_own() -> None:
    writer = Writer()
    views = {"left": REFERENCE, "right": REFERENCE}
    TensorBoardCallback(writer).step(0, 1.0, views, params={"vertices": np.zeros((10, 3))})
    assert set(writer.images) == {"image/left", "image/right"}
    assert set(writer.scalars) == {"fit/value"}


def test_pictures_of_one_fit_have_one_exposure() -> None:
    writer = Writer()
    board = TensorBoardCallback(writer, every=1)
    for step, light in enumerate((8.0, 4.0)):
        board.step(step, 1.0, np.full((4, 4, 3), light))
    (_, first), (_, second) = writer.images["image"]
    assert np.all(first > second)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"writer": object()}, "`writer` must have add_scalar"),
        ({"writer": Writer}, "`writer` must have add_scalar"),
        ({"objective": 3}, "`objective` must have value"),
        ({"every": 0}, "`every` must be a whole number"),
        ({"every": 2.5}, "`every` must be a whole number"),
    ],
)
def test_what_cannot_be_is_refused(arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(OptionError, match=says):
        TensorBoardCallback(**({"writer": Writer()} | arguments))
