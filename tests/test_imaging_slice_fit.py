"""What of a needle in thick slices is found before it is fitted: its pieces, its hub."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from needlefit.imaging.needle.hub import find_hub
from needlefit.imaging.needle.rod_projection import CELL_MM, VIEW_GROWTH, VIEW_STEP, Rod
from needlefit.imaging.needle.segmentation import find_tubes
from needlefit.imaging.volume import Volume, to_index, to_patient, turn_slices
from needlefit.schemas.reconstruction import ReconstructionRecord

RECIPE = ReconstructionRecord.model_validate(
    {"schema": 2, "needle": {"length_mm": 100, "diameter_mm": 1.27, "bevel_deg": 30}}
)
NOISE = np.random.default_rng(1).normal(0, 20, (8, 40, 200)).astype(np.float32)


def in_slices(values):
    return Volume(values, np.zeros(3), np.array([0.4, 0.4, 2.0]), np.eye(3))


def test_pieces_of_a_needle_in_successive_slices_are_one_tube():
    values = NOISE.copy()
    for n, k in enumerate(range(2, 6)):  # 9 mm of the needle in each slice, and 6 mm that rays hide
        values[k, 19:22, 20 + 38 * n : 43 + 38 * n] = 3000
    (tube,) = find_tubes(in_slices(values), RECIPE)
    assert (tube.voxels[:, 0].min(), tube.voxels[:, 0].max()) == (20, 156)


def test_a_hub_before_a_needle_is_found_and_slices_along_another_axis_are_turned():
    size, spacing = np.array([40, 40, 120]), np.array([0.5, 1.0, 0.5])
    i, j, k = np.meshgrid(*(np.arange(n) for n in size), indexing="ij")
    x, y, z = (one * step for one, step in zip((i, j, k), spacing, strict=True))
    away = np.hypot(x - 10, y - 20)
    metal = (away < 0.64) & (z < 50) | (away < 3) & (z < 15)
    volume = Volume(np.where(metal, 3000, -1000).T.astype(np.float32), np.zeros(3), spacing, np.eye(3))
    points = np.array([[10.0, 20, at] for at in np.arange(22.0, 50)])
    hub = find_hub(volume, points, 1.27)
    assert hub is not None and abs(hub.radius - 3) < 0.5 and find_hub(volume, points[::-1], 1.27) is None
    assert_allclose(hub.ends[1], [10, 20, 15], atol=0.5)
    turned = turn_slices(volume)
    assert turned.spacing.tolist() == [0.5, 0.5, 1.0] and turn_slices(turned) is turned
    n = np.rint(to_index(turned, to_patient(volume, [[20, 20, 100]]))[0]).astype(int)
    assert turned.values[tuple(n[::-1])] == volume.values[100, 20, 20]


@pytest.mark.parametrize("roll", [0.0, 1.2, np.pi / 2, -np.pi / 2])
def test_a_rod_grows_in_a_plane_by_its_width_wherever_its_bevel_faces(roll):
    columns, thick = np.arange(8.0, -8, -CELL_MM), 2.0
    samples = thick * np.arange(3), np.array([0.0]), np.zeros((1, 1))
    rod = Rod(columns, 0.6, np.tan(np.radians(30)), thick, *samples, VIEW_STEP, VIEW_GROWTH)
    middle = int(np.argmin(np.abs(rod.planes - 2)))
    across, along = np.zeros((2, len(columns)))
    along += rod.planes[middle]
    ends = np.linspace(4.0, 4.5, 11)
    areas = [rod.lengths(across, along, end, roll)[[middle]].sum() for end in ends]
    growth = np.diff(areas) * CELL_MM / len(rod.views[0]) / np.diff(ends)
    assert_allclose(growth, 1.19, rtol=0.25)  # the mean chord of the plane
