"""Measured settings, and the recommendation among them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from loi_core.tradeoff import MAX_NOISE_FRACTION, TOLERANCE, pareto_set, recommend, settings_of
from tests.helpers import SCALES


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6))))
def test_the_pareto_set_has_exactly_the_points_that_no_point_dominates(points: list[tuple[int, int]]) -> None:
    def is_dominated(point: tuple[int, int]) -> bool:
        return any(better != point and better[0] <= point[0] and better[1] <= point[1] for better in points)

    assert pareto_set(points) == [not is_dominated(point) for point in points]


@given(
    st.lists(st.tuples(st.floats(1e-3, 10.0), st.floats(0.0, 0.1)), min_size=1),
    st.none() | st.floats(0.0, 0.5),
)
def test_the_recommendation_is_the_fastest_point_with_an_allowed_error(
    points: list[tuple[float, float]], noise: float | None
) -> None:
    allowed = TOLERANCE if noise is None else MAX_NOISE_FRACTION * noise
    advice = recommend(points, noise)
    assert advice is not None
    seconds, error = points[advice.index]
    assert (advice.error, advice.allowed, advice.noise) == (error, allowed, noise)
    assert advice.is_allowed == any(point[1] <= allowed for point in points)
    if advice.is_allowed:
        assert error <= allowed
        assert all(point[0] >= seconds for point in points if point[1] <= allowed)
    else:
        assert error == min(point[1] for point in points)


def test_without_measurements_there_is_no_recommendation() -> None:
    assert recommend([], None) is None


@pytest.mark.parametrize("name", SCALES)
def test_every_setting_changes_at_most_one_option_and_keeps_a_scale(name: str) -> None:
    scales = SCALES[name]
    settings = settings_of("any", ("float32", "float64"), scales)
    assert len(set(settings)) == len(settings)
    for setting in settings:
        changed = [key for key in ("sigma", "alpha", "beta") if getattr(setting.scales, key) != getattr(scales, key)]
        assert len(changed) == (1 if setting.change else 0)
        assert not setting.change or (setting.accuracy, setting.dtype) == ("balanced", "float32")
    omissions = [setting for setting in settings if setting.change.startswith("without")]
    assert len(omissions) == sum(len(values) for values in (scales.sigma, scales.alpha) if len(values) > 1)
