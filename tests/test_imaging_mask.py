"""A needle's mask counts where it stands, whatever the order of its voxels."""

from dataclasses import replace
from functools import cache

import ct_cases as cases
import numpy as np
import pytest
from numpy.testing import assert_allclose
from reading_here import child_process_reader, read_here  # noqa: F401 - fixtures
from refusals import refusal
from scanner.render import Needle3D
from scanner.write import write_volume

from needlefit.errors import DataError
from needlefit.imaging.needle import segmentation
from needlefit.imaging.needle.centerline import trace_needle
from needlefit.imaging.needle.follow import follow_points, read_mask_points
from needlefit.imaging.volume import to_patient

pytestmark = pytest.mark.usefixtures("read_here")

TRUTH = cases.axis(curve=(2.0, 0.0))


@pytest.fixture(scope="module")
def volume():
    """Two needles, 5 mm apart along L."""
    return cases.scan(TRUTH, scene={"needles": (Needle3D(TRUTH + np.array([5.0, 0, 0])),)})


@pytest.fixture(scope="module")
def mask(volume):
    """The first of them."""
    values = np.zeros_like(volume.values)
    values[:, :, :29] = volume.values[:, :, :29] > 1500
    return replace(volume, values=values)


def saved(folder, mask):
    write_volume(mask, folder / "mask.nrrd")
    return folder / "mask.nrrd"


@pytest.mark.sweep
def test_a_mask_replaces_the_thresholds(volume, mask, tmp_path):
    refusal(DataError, "2 needles", segmentation.select_needle, volume, cases.RECIPE)
    points = read_mask_points(saved(tmp_path, mask))
    line = trace_needle(volume, follow_points(volume, points, cases.RECIPE), cases.RECIPE)
    assert np.linalg.norm(line.end.point - TRUTH[-1]) < 0.15


@pytest.mark.parametrize("moved", [{"origin": (0.0, 0, 200.0)}, {"origin": (-4.0, -3.0, 0)}])
def test_a_mask_from_another_place_or_an_empty_one_is_refused(moved, volume, mask, tmp_path):
    ((key, by),) = moved.items()
    points = read_mask_points(saved(tmp_path, replace(mask, **{key: getattr(mask, key) + by})))
    assert refusal(DataError, "", follow_points, volume, points, cases.RECIPE).fix
    empty = saved(tmp_path, replace(mask, values=np.zeros_like(mask.values)))
    assert str(empty) in str(refusal(DataError, "0 voxels", read_mask_points, empty))


# ---- which tube of a scan is the needle, and what is cut off it

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


def spans(part):
    """Where a component begins and ends along S, mm."""
    return np.sort(segmentation.find_ends(part)[:, 2])


@pytest.mark.sweep
@pytest.mark.parametrize("radius", [2.5, 4.0])
def test_a_hub_on_the_shaft_is_cut_off(radius):
    volume = painted(rod((11.0, 11.0), 0.0, 5.0, radius))
    part = segmentation.select_needle(volume, cases.RECIPE).needle
    low, high = spans(part)
    assert 5.0 < low < 9.0
    assert_allclose(high, spans(segmentation.select_needle(scan(), cases.RECIPE).needle)[1], atol=0.5)
    line = trace_needle(volume, part, cases.RECIPE)
    assert line.end.point[2] > 38  # the hub's end is no tip


def test_a_shorter_tube_is_named_and_of_two_long_ones_the_stated_diameter_taken():
    volume = painted(rod((16.0, 8.0), 6.0, 28.0, 0.7))
    found = segmentation.select_needle(volume, cases.RECIPE)
    assert spans(found.needle)[1] > 38
    assert len(found.others) == len(found.warnings) == 1
    assert_allclose(spans(found.others[0]), [6.0, 28.0], atol=1.0)
    picked = segmentation.select_needle(volume, cases.RECIPE, np.array([17.0, 8.0, 20.0]))
    assert_allclose(spans(picked.needle), [6.0, 28.0], atol=1.0)
    refused = refusal(
        DataError, "", lambda: segmentation.select_needle(volume, cases.RECIPE, np.array([2.0, 20.0, 20.0]))
    )
    assert "needle_x_mm" in refused.where
    alike = painted(rod((17.0, 6.0), 0.0, 38.0, 0.8))
    refusal(DataError, "needles", segmentation.select_needle, alike, cases.RECIPE)
    thick = painted(rod((17.0, 6.0), 0.0, 45.0, 1.6))
    wide = cases.recipe(needle={"diameter_mm": 1.4})
    found = segmentation.select_needle(thick, wide)
    assert_allclose(found.needle.width, 1.6, atol=0.4)
    assert len(found.warnings) == 1
