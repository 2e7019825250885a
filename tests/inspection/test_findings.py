"""The numbers of an inspection agree with the loss: value, gradient, histograms and reach."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import pytest

from loi_core import LOIObjective, NonFiniteImageError, ScaleSpace
from loi_core.errors import ScaleError
from loi_core.inspection import inspect_pair, make_pair
from loi_core.inspection import pair as pairs
from loi_core.inspection.drawing import isophote_lines, loss_colours
from loi_core.inspection.maps import histograms_at
from loi_core.inspection.packing import packed_histograms
from loi_core.inspection.pair import averaged, shifted
from loi_core.inspection.reach import furthest_rise, reach_of_object
from loi_core.method.reference import dense_blur, loss_and_gradient
from tests.helpers import Host
from tests.inspection.pictures import disks, textures

SCALES = {
    "for image": ScaleSpace.for_image(21, 30),
    "paper vector": ScaleSpace.paper("vector"),
    "flat": ScaleSpace((0, 90), (0, 500), 0.1),
    "all rules": ScaleSpace((1, 4), (2, 9), (0.125, 0.05), bounds=(-0.5, 2.0), boundary="zero", p=0.5),
}


@pytest.mark.parametrize("name", SCALES)
def test_loss_maps_and_gradients_of_all_scales_add_up_to_the_loss(name: str) -> None:
    image, reference = textures(21, 30)
    findings = inspect_pair(make_pair(image, reference, SCALES[name]))
    objective = LOIObjective(reference, SCALES[name])
    value, gradient = loss_and_gradient(image, reference, SCALES[name])
    assert sum(float(scale.loss.mean()) for scale in findings.scales) == pytest.approx(value, rel=1e-12)
    terms = objective.terms(image)
    expected = [float(terms[scale.key]) for scale in findings.scales]
    assert [scale.value for scale in findings.scales] == pytest.approx(expected)
    assert sum(scale.share for scale in findings.scales) == pytest.approx(1.0)
    np.testing.assert_allclose(
        sum(scale.gradient for scale in findings.scales), gradient, atol=1e-12 * abs(gradient).max()
    )


def test_a_pair_of_equal_images_has_no_loss_anywhere() -> None:
    image, _ = textures(12, 16)
    findings = inspect_pair(make_pair(image, image.copy(), ScaleSpace.for_image(12, 16)))
    assert findings.value == 0.0
    for scale in findings.scales:
        assert scale.share == 0.0
        assert not scale.loss.any()
        assert not scale.gradient.any()


@pytest.mark.parametrize("name", ["for image", "flat"])
def test_histograms_sum_to_one_and_agree_with_the_reference_implementation(name: str) -> None:
    image, _ = textures(21, 30)
    scales = SCALES[name]
    rows, columns = [0, 4, 20], [3, 29]
    for sigma in scales.sigma:
        histograms = histograms_at(image, scales, sigma, scales.beta[0], rows, columns)
        np.testing.assert_allclose(histograms.sum(axis=2), 1.0, atol=1e-4)
        for channel in range(3):
            inner = dense_blur((21, 30), sigma, scales.boundary, None).apply(image[..., channel])
            offsets = (scales.levels(scales.beta[0])[:, None, None] - inner) / scales.beta[0]
            density = np.exp(-0.5 * offsets**2) / np.sqrt(2.0 * np.pi)
            for index, alpha in enumerate(scales.alpha):
                expected = dense_blur((21, 30), alpha, scales.boundary, None).apply(density)[:, rows][:, :, columns]
                np.testing.assert_allclose(histograms[index, channel], expected, atol=1e-12)


def test_the_distance_of_two_local_histograms_is_the_loss_map() -> None:
    image, reference = textures(21, 30)
    scales = SCALES["for image"]
    findings = inspect_pair(make_pair(image, reference, scales))
    first, second = (
        histograms_at(array, scales, 1.0, scales.beta[0], range(21), range(30)) for array in (image, reference)
    )
    distance = np.abs(np.cumsum(first - second, axis=2)).sum(axis=2).mean(axis=1) * scales.spacing(scales.beta[0])
    for index, scale in enumerate(findings.scales):
        np.testing.assert_allclose(scale.loss, distance[index], atol=1e-12)


def unpacked(facts: dict[str, Any]) -> Host:
    """Return fractions, shape (images, extents, channels, levels, rows, columns), of facts with one group."""
    differences = np.frombuffer(zlib.decompress(base64.b64decode(facts["packed"])), np.uint8)
    roots = np.cumsum(differences, dtype=np.uint8) / 255.0
    group = facts["groups"][0]
    counts = (len(group["alphas"]), len(facts["channels"]), len(group["levels"]))
    return (roots**2).reshape(2, *counts, len(facts["rows"]), len(facts["columns"]))


def test_histograms_survive_being_packed_into_bytes() -> None:
    image, reference = textures(60, 80)
    pair = make_pair(image, reference, ScaleSpace.for_image(60, 80))
    facts = packed_histograms(pair)
    fractions = unpacked(facts)
    expected = histograms_at(reference, pair.scales, 1.0, 0.125, facts["rows"], facts["columns"])
    np.testing.assert_allclose(fractions[1], expected, atol=1.0 / 255.0)
    np.testing.assert_allclose(fractions.sum(axis=3), 1.0, atol=0.02)


def test_a_grey_pair_has_one_channel_and_the_same_loss() -> None:
    image, reference = (image.repeat(3, axis=-1) for image in textures(20, 24, channels=1))
    scales = ScaleSpace.for_image(20, 24)
    pair = make_pair(image, reference, scales)
    assert pair.image.shape == (20, 24, 1)
    assert packed_histograms(pair)["channels"] == ("grey",)
    assert inspect_pair(pair).value == pytest.approx(float(LOIObjective(reference, scales).value(image)), rel=1e-12)


def test_a_single_image_is_compared_with_itself_shifted_to_the_right() -> None:
    image, _ = textures(30, 200)
    pair = make_pair(image, None, ScaleSpace.for_image(30, 200))
    assert pair.shift == 2
    np.testing.assert_array_equal(pair.reference, image)
    np.testing.assert_array_equal(pair.image[:, 2:], image[:, :-2])
    np.testing.assert_array_equal(pair.image[:, :2], image[:, [0, 0]])


def test_shifting_repeats_the_pixels_at_the_edge() -> None:
    ramp = np.arange(12.0).reshape(3, 4, 1)
    np.testing.assert_array_equal(shifted(ramp, 1, 0)[..., 0], [[0, 1, 2, 3], [0, 1, 2, 3], [4, 5, 6, 7]])
    np.testing.assert_array_equal(shifted(ramp, 0, -9)[..., 0], [[3] * 4, [7] * 4, [11] * 4])


def test_the_reach_of_wider_scales_is_longer_and_agrees_with_theory() -> None:
    scales = ScaleSpace(1, (8, 14, 24), 0.125)
    reaches = list(reach_of_object(scales, 192, 256).values())
    assert [reach.at_least for reach in reaches] == [False] * 3
    distances = [reach.distance for reach in reaches]
    # The slope of erf(d / (sqrt(8) s)) is 1 % there, for a disk of 5 pixels at the scales alpha and sigma.
    expected = [np.sqrt(8.0 * np.log(100.0)) * np.sqrt(alpha**2 + 1.0 + 0.25 * 5.1**2) for alpha in scales.alpha]
    assert distances == pytest.approx(expected, rel=0.1)
    assert distances == sorted(distances)


def test_the_reach_is_in_pixels_of_the_file_and_the_default_scales_span_it() -> None:
    small, large = (
        list(reach_of_object(ScaleSpace.for_image(*size), *size).values()) for size in ((96, 128), (768, 1024))
    )
    assert small[0].distance * 8.0 == pytest.approx(large[0].distance, rel=0.05)
    assert large[-1].at_least
    assert large[-1].distance == pytest.approx(0.75 * 1024, rel=0.02)


def test_the_reach_ends_where_the_slope_changes_sign_or_fades() -> None:
    distances = [0.0, 1.0, 2.0, 3.0, 4.0]
    assert str(furthest_rise(distances, np.array([0.0, 1.0, 2.0, 3.0, 4.0]))) == "4 px or more"
    reach = furthest_rise(distances, np.array([0.0, 1.0, 2.0, 1.0, 3.0]))
    assert 1.5 < reach.distance < 2.5
    assert not reach.at_least
    assert furthest_rise(distances, np.array([0.0, 1.0, 2.0, 2.005, 3.0])).distance < 2.5
    assert furthest_rise(distances, np.zeros(5)).distance == 0.0


def test_the_loss_of_a_shifted_disk_rises_farther_at_wider_extents() -> None:
    image, reference = disks()
    findings = inspect_pair(make_pair(image, reference, ScaleSpace(0.5, (1, 3), 0.125)))
    narrow, wide = (scale.rise.distance for scale in findings.scales)
    assert narrow < wide
    assert all(findings.shifts.values[scale.key][0] == 0.0 for scale in findings.scales)


def test_large_images_are_averaged_and_keep_nearly_their_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pairs, "MAX_PIXELS", 2**13)
    height, width = 105, 241
    image, reference = disks(height, width)
    scales = ScaleSpace(2, (10, 80), 0.125)
    pair = make_pair(image, reference, scales)
    assert pair.factor == 2
    assert pair.image.shape == (53, 121, 3)
    assert pair.computed_scales.alpha == (5, 40)
    assert "241 x 105 pixels" in pair.notes[-1]
    smaller = float(LOIObjective(pair.reference, pair.computed_scales).value(pair.image))
    assert smaller == pytest.approx(float(LOIObjective(reference, scales).value(image)), rel=0.02)
    facts = packed_histograms(pair)
    assert max(facts["rows"]) < height
    assert 0.95 * width < max(facts["columns"]) < width


def test_averaging_uses_smaller_blocks_at_the_far_edges() -> None:
    image = np.arange(15.0).reshape(3, 5, 1)
    np.testing.assert_allclose(averaged(image, 2)[..., 0], [[3.0, 5.0, 6.5], [10.5, 12.5, 14.0]])


def test_pairs_that_cannot_be_inspected_are_refused() -> None:
    image, reference = textures(8, 9)
    broken = image.copy()
    broken[2, 3, 1] = np.nan
    with pytest.raises(NonFiniteImageError, match="`image` has 1 non-finite value"):
        make_pair(broken, reference, ScaleSpace.for_image(8, 9))
    with pytest.raises(NonFiniteImageError, match="`reference` has 1 non-finite value"):
        make_pair(image, broken, ScaleSpace.for_image(8, 9))
    with pytest.raises(ScaleError, match="`scales` must follow the convention 'paper'"):
        make_pair(image, reference, ScaleSpace.released(1, 1, 8, 5))
    bright = make_pair(image, 3.0 * reference, ScaleSpace.for_image(8, 9))
    assert "lies beyond the scales' `bounds` (0, 1)" in bright.notes[0]


def test_isophotes_run_where_a_channel_crosses_a_level() -> None:
    ramp = np.linspace(0.0, 1.0, 401)
    inner = np.stack([ramp, np.full(401, 0.3), 1.0 - ramp], axis=-1)[None].repeat(9, axis=0)
    lines = isophote_lines(inner, np.array([0.25, 0.75]), 0.125, 1)
    assert lines[..., 1].max() == 0.0
    for channel in (0, 2):
        assert set(np.flatnonzero(lines[4, :, channel])) == {99, 100, 101, 299, 300, 301}


def test_the_colours_of_a_loss_get_brighter_from_black() -> None:
    colours = loss_colours(np.linspace(0.0, 1.0, 64).reshape(8, 8)).reshape(64, 3)
    assert colours[0].max() < 0.02
    assert np.all(np.diff(colours @ [0.2126, 0.7152, 0.0722]) >= 0.0)
    assert not loss_colours(np.zeros((2, 2)))[..., :2].any()
