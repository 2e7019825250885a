"""What is tried, and what is recommended of it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core.tradeoff import HIDDEN, WITHIN, pareto_set, recommend, settings_of
from tests.helpers import SCALES


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6))))
def test_the_pareto_set_is_what_no_other_point_beats(points: list[tuple[int, int]]) -> None:
    def beaten(point: tuple[int, int]) -> bool:
        return any(one != point and one[0] <= point[0] and one[1] <= point[1] for one in points)

    assert pareto_set(points) == [not beaten(point) for point in points]


@given(
    st.lists(st.tuples(st.floats(1e-3, 10.0), st.floats(0.0, 0.1)), min_size=1),
    st.none() | st.floats(0.0, 0.5),
)
def test_what_is_recommended_is_the_fastest_of_those_that_are_accurate_enough(
    points: list[tuple[float, float]], noise: float | None
) -> None:
    allowed = WITHIN if noise is None else HIDDEN * noise
    advice = recommend(points, noise)
    assert advice is not None
    seconds, error = points[advice.index]
    assert (advice.error, advice.allowed, advice.noise) == (error, allowed, noise)
    assert advice.met == any(one[1] <= allowed for one in points)
    if advice.met:
        assert error <= allowed
        assert all(one[0] >= seconds for one in points if one[1] <= allowed)
    else:
        assert error == min(one[1] for one in points)


def test_nothing_is_recommended_where_nothing_was_measured() -> None:
    assert recommend([], None) is None


@pytest.mark.parametrize("name", SCALES)
def test_every_change_is_of_one_thing_and_leaves_something_to_compare(name: str) -> None:
    scales = SCALES[name]
    listed = settings_of("any", ("float32", "float64"), scales)
    assert len(set(listed)) == len(listed)
    for one in listed:
        differs = [key for key in ("sigma", "alpha", "beta") if getattr(one.scales, key) != getattr(scales, key)]
        assert len(differs) == (1 if one.change else 0)
        assert not one.change or (one.accuracy, one.dtype) == ("balanced", "float32")
    left_out = [one for one in listed if one.change.startswith("without")]
    assert len(left_out) == sum(len(each) for each in (scales.sigma, scales.alpha) if len(each) > 1)
