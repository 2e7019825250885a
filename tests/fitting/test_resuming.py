"""A resumed fit equals an uninterrupted one, wherever it was stopped."""

from __future__ import annotations

import dis
import itertools
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from loi_core import Free, LOIObjective, PixelL2, fit
from loi_core.errors import FitError, OptionError, ParameterError
from loi_core.fitting.loop import FitInterruptedError, FitStep
from loi_core.fitting.state import State
from loi_core.renderers import Disks
from tests.fitting.fits import REFERENCE, SCALES, SCENE, START, TARGET, Bowl, run
from tests.helpers import Host


@pytest.mark.parametrize("interrupted", [True, False])
def test_a_checkpoint_that_cannot_be_written_leaves_the_result(
    interrupted: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(*_: object, **__: object) -> None:
        message = "no space left"
        raise OSError(message)

    def stop(step: FitStep, params: Any, image: Any) -> None:
        if interrupted and step.step == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr("loi_core.fitting.checkpoint.save_checkpoint", full)
    error = FitInterruptedError if interrupted else FitError
    caught: Any
    with pytest.raises(error, match=r"step .: writing the checkpoint failed: OSError: no space left") as caught:
        run(steps=4, checkpoint=tmp_path / "state.npz", callback=stop)
    assert len(caught.value.result.history) == (3 if interrupted else 4)


def test_a_resumed_fit_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    whole = run(steps=40)
    file = tmp_path / "state.npz"

    def stop(step: FitStep, params: Any, image: Any) -> None:
        if step.step == 17:
            raise KeyboardInterrupt

    with pytest.raises(FitInterruptedError) as caught:
        run(steps=40, checkpoint=file, callback=stop)
    assert caught.value.result is not None
    assert len(caught.value.result.history) == 18
    resumed = run(steps=40, checkpoint=file, resume=True)
    np.testing.assert_array_equal(resumed.params["positions"], whole.params["positions"])
    np.testing.assert_array_equal(resumed.best_params["positions"], whole.best_params["positions"])
    assert [entry.value for entry in resumed.history] == [entry.value for entry in whole.history]
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


def test_a_checkpoint_of_other_settings_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    file.write_bytes(b"not a checkpoint")
    with pytest.raises(ParameterError, match="is not a checkpoint of a fit"):
        run(steps=3, checkpoint=file, resume=True)
    file.unlink()
    run(steps=3, checkpoint=file)
    with pytest.raises(ParameterError, match="`checkpoint` was made with learning rates"):
        fit(Bowl(), PixelL2(np.ones((2, 2, 1))), steps=3, learning_rate=1, checkpoint=file, resume=True)
    with pytest.raises(ParameterError, match="`checkpoint` was made with steps = 3, this fit has 2"):
        run(steps=2, checkpoint=file, resume=True)
    with pytest.raises(OptionError, match="`checkpoint` must be the path of a file"):
        run(steps=3, checkpoint=tmp_path)
    with pytest.raises(OptionError, match="`checkpoint` must lead to a folder"):
        run(steps=3, checkpoint=file / "below.npz")


def test_a_checkpoint_of_another_start_is_refused(tmp_path: Path) -> None:
    file, bounds = tmp_path / "state.npz", (0.0, 32.0)
    for _ in range(2):
        run(steps=3, checkpoint=file, resume=True)
    with pytest.raises(ParameterError, match="`checkpoint` was made with other start; start without resume"):
        run(steps=3, optimise={"positions": Free(np.add(START, 1.0), *bounds)}, checkpoint=file, resume=True)


def test_a_checkpoint_does_not_depend_on_the_order_of_names(tmp_path: Path) -> None:
    for names in (["positions", "radii"], ["radii", "positions"]):
        run(steps=3, optimise=names, checkpoint=tmp_path / "state.npz", resume=True)


def test_a_fit_removes_unfinished_checkpoints_of_killed_fits(tmp_path: Path) -> None:
    unfinished = tmp_path / ".loi-unfinished-state-a1b2c3d4.npz"
    unfinished.write_bytes(b"half of a checkpoint")
    run(steps=2, checkpoint=tmp_path / "state.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


def test_ctrl_c_while_resuming_leaves_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    file = tmp_path / "state.npz"
    run(steps=3, checkpoint=file)
    content = file.read_bytes()
    monkeypatch.setattr(Disks, "render", interrupt)
    with pytest.raises(FitInterruptedError) as caught:
        run(steps=3, checkpoint=file, resume=True)
    assert caught.value.result is None
    assert file.read_bytes() == content


def test_ctrl_c_within_a_step_discards_that_step(tmp_path: Path) -> None:
    class Interrupted(Disks):
        calls = 0

        def project(self, params: dict[str, Host]) -> dict[str, Host]:
            Interrupted.calls += 1
            if Interrupted.calls == 7:
                raise KeyboardInterrupt
            return super().project(params)

    def go(scene: Disks, **options: Any) -> Any:
        free = {"positions": Free(START, 0.0, 32.0)}
        return fit(scene, LOIObjective(REFERENCE, SCALES), steps=12, learning_rate=1.5, optimise=free, **options)

    whole = go(SCENE)
    file = tmp_path / "state.npz"
    with pytest.raises(FitInterruptedError):
        go(Interrupted(32, 32, TARGET, 5.0, [[0.9, 0.6, 0.1]], confine=True), checkpoint=file)
    resumed = go(SCENE, checkpoint=file, resume=True)
    np.testing.assert_array_equal(resumed.params["positions"], whole.params["positions"])


# The functions that hold the state, and their modules.
STATEFUL = {"fit", "finished", "step", "advance", "_save", "evaluated", "stepped", "result", "history"}
# An interrupt before one of these leaves the state that an interrupt before the next instruction leaves. And Python
# handles no signal between the last value of a function and its return.
WITHOUT_EFFECT = ("LOAD_", "PUSH_", "KW_NAMES", "PRECALL", "BUILD_", "COPY", "SWAP", "NOP", "RESUME", "RETURN_")
HOLDERS = {Path(sys.modules[f"loi_core.fitting.{name}"].__file__ or "") for name in ("loop", "descent", "state")}


def interrupted_after(count: int) -> Any:
    """Return a trace function that raises KeyboardInterrupt after `count` instructions of the loop and its state."""
    remaining = count

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal remaining
        code = frame.f_code
        if code.co_name not in STATEFUL or Path(code.co_filename) not in HOLDERS:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode" and not dis.opname[code.co_code[frame.f_lasti]].startswith(WITHOUT_EFFECT):
            remaining -= 1
            if remaining == 0:
                raise KeyboardInterrupt
        return trace

    return trace


def test_ctrl_c_at_any_instruction_leaves_the_state_between_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    saved: list[State] = []
    monkeypatch.setattr("loi_core.fitting.checkpoint.INTERVAL", 1)
    monkeypatch.setattr("loi_core.fitting.checkpoint.save_checkpoint", lambda path, state, *_: saved.append(state))

    def go(trace: Any) -> Any:
        """Return the result, or the KeyboardInterrupt."""
        trace_before = sys.gettrace()
        saved.clear()
        free: Any = {"optimise": ["pixels"], "checkpoint": "x"}
        try:
            sys.settrace(trace)
            return fit(Bowl(), PixelL2(np.ones((2, 2, 1))), steps=2, learning_rate=0.1, **free)
        except KeyboardInterrupt as stop:
            return stop
        finally:
            sys.settrace(trace_before)

    whole = go(sys.gettrace())
    states = {state.step: state for state in saved}
    params = [Bowl().parameters()["pixels"], states[1].params["pixels"], states[2].params["pixels"]]
    observed: set[tuple[int, int]] = set()
    for count in itertools.count(1):
        outcome = go(interrupted_after(count))
        if not isinstance(outcome, KeyboardInterrupt):
            break
        result = getattr(outcome, "result", None)
        assert (result is None) == (not saved)
        if result is None:
            continue
        last = saved[-1]
        assert last.best is not None
        observed.add((last.step, last.best.step))
        assert [entry.value for entry in result.history] == [entry.value for entry in whole.history[: last.step]]
        assert [entry.value for entry in last.history] == [entry.value for entry in result.history]
        np.testing.assert_array_equal(result.params["pixels"], params[last.step])
        np.testing.assert_array_equal(last.params["pixels"], params[last.step])
        np.testing.assert_array_equal(last.best.params["pixels"], params[last.best.step])
        np.testing.assert_array_equal(result.image, params[result.best_step])
        assert last.memory["count"] == last.step
        for name, value in last.memory.items():
            np.testing.assert_array_equal(value, states[last.step].memory[name])
    assert observed == {(1, 0), (2, 1), (2, 2)}
