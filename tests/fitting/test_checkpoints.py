"""A checkpoint that is damaged anywhere is refused by name; the one before it is used, or an error names both."""

from __future__ import annotations

import os
import pickle
import shutil
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loi_core.errors import CheckpointError, FitError, InUseError, OptionError, ParameterError, WriteError
from loi_core.fitting.generations import Checkpoints, CheckpointWarning, is_due
from loi_core.fitting.loop import FitInterruptedError, FitStep
from tests.fitting.fits import run
from tests.helpers import Host


def test_a_kill_takes_a_hundredth_of_a_long_fit_and_checkpoints_write_at_most_200_histories() -> None:
    kept = [step for step in range(1, 200_001) if is_due(step)]
    assert all(later - one <= max(25, one / 100) for one, later in pairwise(kept))
    assert sum(kept) <= 200 * 200_000


STEPS = 30  # with the one after 25 steps there are two checkpoints


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """The folder of a whole fit, and its result."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, run(steps=STEPS, checkpoint=folder / "state.npz")


@pytest.mark.parametrize("name", ["thesis.npz", "thesis.previous.npz"])
def test_a_file_that_is_no_checkpoint_is_not_written_over(tmp_path: Path, name: str) -> None:
    np.savez(tmp_path / name, months=np.arange(3))
    content = (tmp_path / name).read_bytes()
    with pytest.raises(OptionError, match=f"`checkpoint`: .*{name} is there and is no checkpoint of a fit"):
        run(steps=1, checkpoint=tmp_path / "thesis.npz")
    assert (tmp_path / name).read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == [name]


def resumed(folder: Path) -> Any:
    return run(steps=STEPS, checkpoint=folder / "state.npz", resume=True)


def same(one: Any, other: Any) -> None:
    np.testing.assert_array_equal(one.params["positions"], other.params["positions"])
    np.testing.assert_array_equal(one.image, other.image)
    assert [step.value for step in one.history] == [step.value for step in other.history]


def damaged(content: bytes, place: int, bit: int, *, torn: bool) -> bytes:
    return content[:place] if torn else content[:place] + bytes([content[place] ^ (1 << bit)]) + content[place + 1 :]


@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7), torn=st.booleans())
def test_damage_at_any_byte_is_told_and_the_checkpoint_before_it_used(
    whole: tuple[Path, Any], tmp_path_factory: pytest.TempPathFactory, place: float, bit: int, torn: bool
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    shutil.copytree(whole[0], folder, dirs_exist_ok=True)
    content = (folder / "state.npz").read_bytes()
    (folder / "state.npz").write_bytes(damaged(content, int(place * len(content)), bit, torn=torn))
    with pytest.warns(CheckpointWarning, match=r"state\.npz is not a checkpoint of a fit .*state\.previous\.npz"):
        same(resumed(folder), whole[1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same(resumed(folder), whole[1])  # it has been replaced


def test_every_byte_of_a_checkpoint_counts(whole: tuple[Path, Any], tmp_path: Path) -> None:
    file, content = tmp_path / "state.npz", (whole[0] / "state.npz").read_bytes()
    step = 1 if settings.default is not None and settings.default.max_examples > 100 else 13
    for place in range(0, len(content), step):
        for torn in (False, True):
            file.write_bytes(damaged(content, place, place % 8, torn=torn))
            with pytest.raises(CheckpointError):
                Checkpoints(file).load({})
    file.write_bytes(content + b"\0")
    with pytest.raises(CheckpointError, match="torn, or not one"):
        Checkpoints(file).load({})


def test_if_both_are_damaged_the_error_names_both(whole: tuple[Path, Any], tmp_path: Path) -> None:
    for name in ("state.npz", "state.previous.npz"):
        (tmp_path / name).write_bytes((whole[0] / name).read_bytes()[:-1])
    with pytest.raises(CheckpointError) as caught:
        resumed(tmp_path)
    assert "state.npz is not a checkpoint" in str(caught.value)
    assert "nor is the one before it" in str(caught.value)
    assert "state.previous.npz (" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert [Path(path).name for path, _ in caught.value.refused] == ["state.npz", "state.previous.npz"]
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)  # noqa: S301 - our own
    assert sorted(path.name for path in tmp_path.iterdir()) == ["state.npz", "state.previous.npz"]


def test_a_fit_killed_while_it_put_a_checkpoint_in_place_goes_on_from_the_one_before(
    whole: tuple[Path, Any], tmp_path: Path
) -> None:
    shutil.copy(whole[0] / "state.previous.npz", tmp_path)
    with pytest.warns(CheckpointWarning, match=r"state\.npz is missing"):
        same(resumed(tmp_path), whole[1])


def test_the_checkpoint_before_is_kept_until_the_damaged_one_is_replaced(
    whole: tuple[Path, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    (tmp_path / "state.npz").write_bytes(b"damaged")
    before = (tmp_path / "state.previous.npz").read_bytes()

    def stop(step: FitStep, params: Any, image: Any) -> None:
        raise KeyboardInterrupt

    with pytest.warns(CheckpointWarning), pytest.raises(FitInterruptedError):
        run(steps=STEPS, checkpoint=tmp_path / "state.npz", resume=True, callback=stop)
    assert (tmp_path / "state.previous.npz").read_bytes() == before
    same(resumed(tmp_path), whole[1])


def test_a_checkpoint_of_another_fit_is_no_reason_to_use_the_one_before(
    whole: tuple[Path, Any], tmp_path: Path
) -> None:
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    with pytest.raises(ParameterError, match="was made with seed = 0, this fit has 1"):
        run(steps=STEPS, checkpoint=tmp_path / "state.npz", resume=True, seed=1)


def test_a_fit_that_begins_anew_leaves_nothing_of_an_earlier_one_to_resume(
    whole: tuple[Path, Any], tmp_path: Path
) -> None:
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    there: list[list[str]] = []

    def note(step: FitStep, params: Any, image: Any) -> None:
        there.append(sorted(path.name for path in tmp_path.glob("state*")))

    run(steps=2, checkpoint=tmp_path / "state.npz", callback=note)
    assert there == [[], []]


def test_a_fit_that_is_resumed_at_its_end_keeps_both_checkpoints(whole: tuple[Path, Any], tmp_path: Path) -> None:
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    same(resumed(tmp_path), whole[1])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


class Diary:
    """A callback that remembers."""

    def __init__(self, stop: int = -1) -> None:
        self.seen: list[int] = []
        self.stop = stop

    def __call__(self, step: FitStep, params: Any, image: Any, /) -> bool | None:
        if step.step == self.stop:
            raise KeyboardInterrupt
        self.seen.append(step.step)
        return None

    def memory(self) -> dict[str, Host]:
        return {"seen": np.array(self.seen)}

    def restore(self, memory: Any, /) -> None:
        self.seen = memory["seen"].tolist()


@pytest.mark.parametrize("stop", [0, 1, 25, 28])
def test_a_callback_that_was_cut_off_sees_its_step_again_and_remembers_the_others(stop: int, tmp_path: Path) -> None:
    with pytest.raises(FitInterruptedError):
        run(steps=STEPS, checkpoint=tmp_path / "state.npz", callback=Diary(stop))
    again = Diary()
    run(steps=STEPS, checkpoint=tmp_path / "state.npz", resume=True, callback=again)
    assert again.seen == list(range(STEPS))


def test_a_checkpoint_is_one_fits_alone(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"

    def another(step: FitStep, params: Any, image: Any) -> None:
        with pytest.raises(InUseError, match=rf"state\.npz is in use by process {os.getpid()} on "):
            run(steps=2, checkpoint=file, resume=True)
        run(steps=2, checkpoint=tmp_path / "other.npz")

    run(steps=2, checkpoint=file, callback=another)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.npz", "state.npz"]


@pytest.mark.parametrize("failing", ["mkstemp", "fsync", "replace"])
def test_a_checkpoint_that_cannot_be_written_leaves_the_last_one(
    failing: str, whole: tuple[Path, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    def fill(step: FitStep, params: Any, image: Any) -> None:
        if step.step == 25:
            where: dict[str, Any] = {"mkstemp": "tempfile.mkstemp", "fsync": "os.fsync", "replace": "os.replace"}
            monkeypatch.setattr(where[failing], refuse)

    file = tmp_path / "state.npz"
    with pytest.raises(FitError, match=r"step 30: writing the checkpoint failed: WriteError: .*state\.npz could") as no:
        run(steps=STEPS, checkpoint=file, callback=fill)
    assert isinstance(no.value.__cause__, WriteError)
    assert no.value.__cause__.errno == 28
    assert len(no.value.result.history) == STEPS  # type: ignore[attr-defined]
    monkeypatch.undo()
    same(resumed(tmp_path), whole[1])
