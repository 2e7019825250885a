"""Checkpoints are written whole, refused when damaged, and used by one fit at a time."""

from __future__ import annotations

import pickle
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core.errors import CheckpointError, FitError, InUseError, OptionError, ParameterError, WriteError
from loi_core.fitting.checkpoint import is_due, load_checkpoint
from loi_core.fitting.history import rows_of
from loi_core.fitting.loop import FitInterruptedError, FitStep
from tests.fitting.fits import run
from tests.helpers import Host
from tests.strategies import THOROUGH


def test_checkpoints_are_a_hundredth_of_a_fit_apart_and_write_at_most_200_histories() -> None:
    due_steps = [step for step in range(1, 200_001) if is_due(step)]
    assert all(later - earlier <= max(25, earlier / 100) for earlier, later in pairwise(due_steps))
    assert sum(due_steps) <= 200 * 200_000


STEPS = 30


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """Return the folder of an uninterrupted fit, and its result."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, run(steps=STEPS, checkpoint=folder / "state.npz")


def test_a_file_that_is_not_a_checkpoint_is_not_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "thesis.npz"
    np.savez(file, months=np.arange(3))
    content = file.read_bytes()
    with pytest.raises(OptionError, match=r"`checkpoint`: .*thesis\.npz is not a checkpoint of a fit"):
        run(steps=1, checkpoint=file)
    assert file.read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.npz"]


def resumed(folder: Path) -> Any:
    return run(steps=STEPS, checkpoint=folder / "state.npz", resume=True)


def assert_equal_fits(first: Any, second: Any) -> None:
    np.testing.assert_array_equal(first.params["positions"], second.params["positions"])
    np.testing.assert_array_equal(first.image, second.image)
    assert [step.value for step in first.history] == [step.value for step in second.history]


def test_a_damaged_checkpoint_is_refused_or_holds_the_same_values(whole: tuple[Path, Any], tmp_path: Path) -> None:
    file, content = tmp_path / "state.npz", (whole[0] / "state.npz").read_bytes()
    expected = load_checkpoint(whole[0] / "state.npz", {})
    refused = 0
    for offset in range(0, len(content), 1 if THOROUGH else 13):
        file.write_bytes(content[:offset])
        with pytest.raises(CheckpointError, match=r"state\.npz is not a checkpoint of a fit \(.*\); delete it"):
            load_checkpoint(file, {})
        file.write_bytes(content[:offset] + bytes([content[offset] ^ (1 << offset % 8)]) + content[offset + 1 :])
        try:
            actual = load_checkpoint(file, {})
        except CheckpointError:
            refused += 1
        else:  # dates and permissions in the archive do not matter
            assert actual.numbers == expected.numbers
            np.testing.assert_equal(actual.params, expected.params)
            np.testing.assert_equal(actual.memory, expected.memory)
            np.testing.assert_array_equal(rows_of(actual.history), rows_of(expected.history))
    assert refused > len(content) / (1 if THOROUGH else 13) / 2


def test_a_torn_checkpoint_stops_the_resumed_fit_and_stays(whole: tuple[Path, Any], tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    file.write_bytes((whole[0] / "state.npz").read_bytes()[:-1000])
    content = file.read_bytes()
    with pytest.raises(CheckpointError, match=r"state\.npz is not a checkpoint .*it is torn") as caught:
        resumed(tmp_path)
    assert "\n" not in str(caught.value)
    assert caught.value.path == str(file)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)  # noqa: S301 - our own
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]
    assert file.read_bytes() == content


def test_a_checkpoint_of_another_fit_is_refused(whole: tuple[Path, Any], tmp_path: Path) -> None:
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    with pytest.raises(ParameterError, match="was made with seed = 0, this fit has 1"):
        run(steps=STEPS, checkpoint=tmp_path / "state.npz", resume=True, seed=1)


def test_a_fit_without_resume_removes_the_checkpoint_of_an_earlier_fit(whole: tuple[Path, Any], tmp_path: Path) -> None:
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    files: list[list[str]] = []

    def note(step: FitStep, params: Any, image: Any) -> None:
        files.append(sorted(path.name for path in tmp_path.glob("state*")))

    run(steps=2, checkpoint=tmp_path / "state.npz", callback=note)
    assert files == [[], []]


def test_a_fit_that_is_resumed_at_its_end_keeps_the_checkpoint(whole: tuple[Path, Any], tmp_path: Path) -> None:
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    assert_equal_fits(resumed(tmp_path), whole[1])
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]
    assert_equal_fits(resumed(tmp_path), whole[1])


class Diary:
    """A callback that remembers the steps that it has handled."""

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
def test_an_interrupted_callback_receives_its_step_again_and_remembers_the_others(stop: int, tmp_path: Path) -> None:
    with pytest.raises(FitInterruptedError):
        run(steps=STEPS, checkpoint=tmp_path / "state.npz", callback=Diary(stop))
    diary = Diary()
    run(steps=STEPS, checkpoint=tmp_path / "state.npz", resume=True, callback=diary)
    assert diary.seen == list(range(STEPS))


def test_a_checkpoint_is_used_by_one_fit_at_a_time(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"

    def another(step: FitStep, params: Any, image: Any) -> None:
        with pytest.raises(InUseError, match=r"state\.npz is in use by another fit; wait until it ends"):
            run(steps=2, checkpoint=file, resume=True)
        run(steps=2, checkpoint=tmp_path / "other.npz")

    run(steps=2, checkpoint=file, callback=another)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.npz", "state.npz"]


@pytest.mark.parametrize("failing", ["mkstemp", "fsync", "replace"])
def test_a_failed_write_leaves_the_last_checkpoint(
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
    assert_equal_fits(resumed(tmp_path), whole[1])
