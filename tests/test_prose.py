"""The checker of prose and names counts the constructions that it lists, and no others."""

from __future__ import annotations

import pytest

from tests import prose
from tests.prose import Tally, measure


def tally_of(path: str, text: str) -> Tally:
    tally = Tally()
    measure(path, text, tally)
    return tally


@pytest.mark.parametrize(
    "sentence",
    [
        "What moves has a gradient.",
        "The error is that of the loss.",
        "Shapes are told apart by number.",
        "Of a mesh, edges are kept.",
        "An image of which nothing is known.",
        "It is tried by hand.",
    ],
)
def test_the_checker_counts_each_listed_construction(sentence: str) -> None:
    assert len(tally_of("page.md", sentence).dialect) == 1
    assert len(tally_of("module.py", f'"""{sentence}"""\n').dialect) == 1
    assert len(tally_of("module.py", f"# {sentence}\n").dialect) == 1


@pytest.mark.parametrize(
    "sentence",
    [
        "Moving shapes have a gradient.",
        "Return the gradient of the loss with respect to the image.",
        "Clamp the grazing-angle term of the area Jacobian, whose relative derivative is unbounded.",
    ],
)
def test_the_checker_counts_no_plain_sentence(sentence: str) -> None:
    assert tally_of("page.md", sentence).dialect == []


def test_fenced_blocks_and_tables_of_a_page_are_no_prose() -> None:
    page = "```python\nwhat_is = 1  # what is\n```\n| what is | that of |\n"
    assert tally_of("page.md", page).words == 0


def test_the_checker_finds_vague_variables_and_arguments_but_not_attributes() -> None:
    tally = tally_of(
        "module.py", "def blur(image, other):\n    found = image\n    image.place = found\n    return _rest\n"
    )
    assert [hit.split("`")[1] for hit in tally.vague] == ["other", "found"]
    assert tally.names == 3


def test_one_hit_in_a_short_folder_is_allowed() -> None:
    assert not tally_of("page.md", "What moves.").fails
    assert tally_of("page.md", "What moves. What is.").fails


def test_names_of_tests_need_a_subject_and_no_namesake() -> None:
    modules = {
        "a.py": "def test_it_works(): ...\ndef test_a_mean_is_linear(): ...\n",
        "b.py": "def test_a_mean_is_linear(): ...\n",
    }
    faults = prose.test_name_faults(modules)
    assert [fault.split(":")[0] for fault in faults] == ["a.py", "b.py"]
