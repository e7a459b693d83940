"""A needle's mask counts where it stands, whatever the order of its voxels."""

import re
from dataclasses import replace

import ct_cases as cases
import numpy as np
import pytest
from reading_here import child_process_reader, read_here  # noqa: F401 - fixtures

from needlefit.errors import DataError
from needlefit.imaging.needle.centerline import trace_needle
from needlefit.imaging.needle.segmentation import read_mask_component, segment_needle
from needlefit.imaging.volume import Volume
from needlefit.imaging.volume_files import write_volume
from needlefit.synthetic.ct_scene import Needle3D

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


def refused(folder, volume, mask, words):
    path = saved(folder, mask)
    with pytest.raises(DataError, match=words) as error:
        read_mask_component(volume, path, cases.RECIPE)
    assert str(path) in str(error.value) and error.value.fix


def flipped(mask, axis):
    """The same voxels, counted from the other end of an axis (0: i)."""
    last = np.zeros(3)
    last[axis] = mask.grid.size[axis] - 1
    direction = mask.direction.copy()
    direction[:, axis] *= -1
    origin = mask.origin + mask.direction @ (mask.spacing * last)
    return Volume(np.flip(mask.values, 2 - axis).copy(), origin, mask.spacing, direction)


def permuted(mask):
    """The same voxels, i for k."""
    turned = [2, 1, 0]
    values = np.ascontiguousarray(mask.values.transpose(2, 1, 0))
    return Volume(values, mask.origin, mask.spacing[turned], mask.direction[:, turned])


def cropped(mask):
    origin = mask.origin + mask.direction @ (mask.spacing * [4, 6, 0])
    return replace(mask, values=mask.values[:, 6:, 4:].copy(), origin=origin)


@pytest.mark.sweep
def test_a_mask_replaces_the_thresholds(volume, mask, tmp_path):
    with pytest.raises(DataError, match="2 needles"):
        segment_needle(volume, cases.RECIPE)
    line = trace_needle(
        volume, read_mask_component(volume, saved(tmp_path, mask), cases.RECIPE), cases.RECIPE
    )
    assert np.linalg.norm(line.tip - TRUTH[-1]) < 0.15


@pytest.mark.parametrize(
    "stored",
    [
        lambda mask: flipped(mask, 0),
        lambda mask: flipped(flipped(mask, 1), 2),
        permuted,
        lambda mask: flipped(permuted(mask), 2),
        cropped,
    ],
)
def test_the_order_in_which_a_mask_is_stored_changes_nothing(stored, volume, mask, tmp_path):
    plain = read_mask_component(volume, saved(tmp_path, mask), cases.RECIPE)
    other = read_mask_component(volume, saved(tmp_path, stored(mask)), cases.RECIPE)
    assert np.array_equal(other.voxels, plain.voxels)


def test_a_mask_of_other_voxels_is_asked_at_those_of_the_scan(volume, mask, tmp_path):
    """Half the spacing: eight voxels for each of the scan's, about the same centre."""
    fine = mask.values.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    half = mask.spacing / 2
    origin = mask.origin - mask.direction @ (half / 2)
    plain = read_mask_component(volume, saved(tmp_path, mask), cases.RECIPE)
    other = read_mask_component(
        volume, saved(tmp_path, Volume(fine, origin, half, mask.direction)), cases.RECIPE
    )
    assert np.array_equal(other.voxels, plain.voxels)


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        ({"origin": (0.0, 0, 200.0)}, "100 % of what it marks lies outside"),
        ({"origin": (-4.0, -3.0, 0)}, "no brighter"),
        ({"spacing": 1 - cases.SPACING}, "does not lie on the needle"),
    ],
)
def test_a_mask_from_another_place_or_without_its_header_is_refused(moved, words, volume, mask, tmp_path):
    ((key, by),) = moved.items()
    refused(tmp_path, volume, replace(mask, **{key: getattr(mask, key) + by}), words)


@pytest.mark.parametrize(
    ("marks", "words"),
    [
        (lambda values: np.zeros_like(values), "marks 0 voxels"),
        (lambda values: np.ones_like(values), "marks the whole scan"),
        (lambda values: values * (np.arange(len(values)) < 12)[:, None, None], re.escape("mm long")),
    ],
)
def test_masks_that_cannot_be_a_needle(marks, words, volume, mask, tmp_path):
    refused(tmp_path, volume, replace(mask, values=marks(mask.values)), words)
