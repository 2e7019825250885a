"""Generated inputs of every kind end in an answer or in one of the library's errors."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

from tests.fuzz import images, results, scenes
from tests.fuzz.claims import Kind, check

KINDS = (
    Kind("PNG", images.pngs, weight=6),
    Kind("JPEG", images.jpegs, weight=5),
    Kind("EXR", images.exrs, weight=4),
    Kind("NPY", images.npys, weight=6),
    Kind("bombs", images.bombs),
    Kind("damaged scene files", scenes.damaged_scenes, weight=4),
    Kind("scene files with any value", scenes.values, weight=8),
    Kind("checkpoints", results.checkpoints, weight=3, writes=True),
    Kind("result folders", results.reports, writes=True),
)


@pytest.mark.parametrize("inputs", KINDS, ids=lambda inputs: inputs.name)
def test_every_input_ends_in_an_answer_or_one_of_our_errors(inputs: Kind, tmp_path: Path) -> None:
    assert settings.default is not None
    count = settings.default.max_examples * inputs.weight // 2
    answers = {check(inputs, seed, tmp_path) for seed in range(count)}
    assert not all(answer.endswith("Error") for answer in answers)  # some inputs are good
