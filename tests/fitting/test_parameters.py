"""Moves of the free numbers of a fit, one by one, to measure the effect of each."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from loi_core.fitting.parameters import Bounds, free_numbers, moved_numbers
from tests.helpers import Host

SIZES = st.floats(0.0, 8.0)
STEPS = st.one_of(st.floats(1e-3, 20.0), st.just(math.inf))


@given(
    arrays(np.float64, (2, 3), elements=st.floats(-5.0, 5.0)),
    arrays(np.float64, (2, 3), elements=SIZES),
    arrays(np.float64, (2, 3), elements=SIZES),
    STEPS,
)
def test_every_free_number_moves_alone_and_within_its_bounds(
    value: Host, below: Host, above: Host, step: float
) -> None:
    bounds = Bounds({"places": value - below}, {"places": value + above})
    moves = list(moved_numbers({"places": value, "fixed": value}, bounds, {"places": step}))
    assert len(moves) == free_numbers(bounds)
    for move in moves:
        changed = move.params["places"] != value
        assert changed[move.index]
        assert np.count_nonzero(changed) == 1
        assert np.all((move.params["places"] >= value - below) & (move.params["places"] <= value + above))
        assert abs(move.params["places"][move.index] - value[move.index]) <= step + np.spacing(16.0)
        assert move.params["fixed"] is value


@pytest.mark.parametrize(
    ("lower", "upper", "step", "end"),
    [
        (-1.0, 4.0, 0.5, 0.5),
        (-4.0, 1.0, 0.5, -0.5),
        (-1.0, 4.0, 9.0, 4.0),
        (-1.0, 4.0, math.inf, 4.0),
        (-math.inf, 4.0, math.inf, -1.0),
        (-math.inf, math.inf, 0.5, 0.5),
    ],
)
def test_a_number_moves_towards_its_farther_bound(lower: float, upper: float, step: float, end: float) -> None:
    (move,) = moved_numbers({"x": np.zeros(())}, Bounds({"x": np.array(lower)}, {"x": np.array(upper)}), {"x": step})
    assert float(move.params["x"]) == end


def test_the_numbers_of_a_parameter_may_move_together() -> None:
    bounds = Bounds({"x": np.array([0.0, 0.0, 5.0])}, {"x": np.array([9.0, 9.0, 5.0])})
    (move,) = moved_numbers({"x": np.array([1.0, 8.0, 5.0])}, bounds, {"x": 0.5}, together=True)
    np.testing.assert_array_equal(move.params["x"], [1.5, 7.5, 5.0])
