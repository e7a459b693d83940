"""Which tube of a scan is the needle, and what is cut off it: bodies painted into a synthetic scan."""

from dataclasses import replace
from functools import cache

import ct_cases as cases
import numpy as np
import pytest
from numpy.testing import assert_allclose

from needlefit.errors import DataError
from needlefit.imaging.needle.centerline import trace_needle
from needlefit.imaging.needle.segmentation import (
    cut_wide_parts,
    find_ends,
    measure_component,
    segment_needle,
    select_needle,
)
from needlefit.imaging.volume import Volume, to_patient

METAL_HU = 3000.0


@cache
def scan():
    return cases.scan(cases.axis(curve=(0.0, 1.0)))


@cache
def places():
    shape = scan().values.shape
    k, j, i = np.indices(shape)
    return to_patient(scan(), np.stack([i, j, k], axis=-1).reshape(-1, 3)).reshape(*shape, 3)


def rod(at, low, high, radius):
    """The voxels of a rod along S at (L, P), from `low` to `high`, mm."""
    points = places()
    inside = np.hypot(points[..., 0] - at[0], points[..., 1] - at[1]) <= radius
    return inside & (points[..., 2] >= low) & (points[..., 2] <= high)


def painted(*bodies, hu=METAL_HU):
    values = scan().values.copy()
    for body in bodies:
        values[body] = hu
    return replace(scan(), values=values)


def spans(part, volume):
    """Where a component begins and ends along S, mm."""
    return np.sort(find_ends(volume, part)[:, 2])


@pytest.mark.sweep
@pytest.mark.parametrize("radius", [2.5, 4.0])
def test_a_hub_on_the_shaft_is_cut_off(radius):
    volume = painted(rod((11.0, 11.0), 0.0, 5.0, radius))
    part = segment_needle(volume, cases.RECIPE)
    low, high = spans(part, volume)
    assert 5.0 < low < 9.0
    assert_allclose(high, spans(segment_needle(scan(), cases.RECIPE), scan())[1], atol=0.5)
    line = trace_needle(volume, part, cases.RECIPE)
    assert line.tip[2] > 38  # the hub's end is no tip


def test_a_holder_in_the_middle_leaves_one_needle_and_what_is_thin_is_not_cut():
    volume = painted(rod((11.0, 11.0), 17.0, 23.0, 4.0))
    low, high = spans(segment_needle(volume, cases.RECIPE), volume)
    assert low < 1.0
    assert high > 38.0
    part = segment_needle(scan(), cases.RECIPE)
    (same,) = cut_wide_parts(scan(), part.voxels, 3.2)
    assert same is part.voxels


def test_a_ball_in_a_rod_is_cut_out_by_its_width():
    shape = (40, 40, 100)
    i, j, k = np.indices(shape)
    rod_ = np.hypot(i - 20, j - 20) <= 1.6
    ball = (i - 20) ** 2 + (j - 20) ** 2 + (k - 50) ** 2 <= 10**2
    volume = Volume(np.zeros(shape[::-1], np.float32), np.zeros(3), np.full(3, 0.5), np.eye(3))
    pieces = cut_wide_parts(volume, np.argwhere(rod_ | ball), 2.5)
    long = sorted(pieces, key=len)[-2:]
    ends = sorted((one[:, 2].min(), one[:, 2].max()) for one in long)
    assert ends[0][0] == 0
    assert 34 <= ends[0][1] <= 40
    assert 60 <= ends[1][0] <= 66
    assert ends[1][1] == 99
    assert measure_component(volume, long[0]).width < 2.5


def test_a_shorter_tube_is_named_and_of_two_long_ones_the_stated_diameter_taken():
    volume = painted(rod((16.0, 8.0), 6.0, 28.0, 0.7))
    found = select_needle(volume, cases.RECIPE)
    assert spans(found.needle, volume)[1] > 38
    assert len(found.others) == len(found.warnings) == 1
    assert_allclose(spans(found.others[0], volume), [6.0, 28.0], atol=1.0)
    picked = select_needle(volume, cases.RECIPE, np.array([17.0, 8.0, 20.0]))
    assert_allclose(spans(picked.needle, volume), [6.0, 28.0], atol=1.0)
    with pytest.raises(DataError) as refused:
        select_needle(volume, cases.RECIPE, np.array([2.0, 20.0, 20.0]))
    assert "needle_x_mm" in refused.value.where
    alike = painted(rod((17.0, 6.0), 0.0, 38.0, 0.8))
    with pytest.raises(DataError, match="needles"):
        select_needle(alike, cases.RECIPE)
    thick = painted(rod((17.0, 6.0), 0.0, 45.0, 1.9))
    wide = cases.recipe(needle={"diameter_mm": 1.4}, segmentation={"max_widening": 3.0})
    found = select_needle(thick, wide)
    assert_allclose(found.needle.width, 1.6, atol=0.4)
    assert len(found.warnings) == 1


@pytest.mark.sweep
def test_a_plastic_hub_is_no_tissue():
    """Soft material at both ends: the tip is where it lasts longer."""
    volume = painted(rod((11.0, 11.0), 0.0, 2.6, 7.0) & ~rod((11.0, 11.0), 0.0, 9.0, 1.2), hu=80.0)
    values = volume.values.copy()
    origin = np.array([0.0, 0.0, 0.46])
    shorter = Volume(values[1:], origin, volume.spacing, volume.direction)
    line = trace_needle(shorter, segment_needle(shorter, cases.RECIPE), cases.RECIPE)
    assert line.tip[2] > 38
