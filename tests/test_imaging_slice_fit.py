"""A rod in thick slices, through its projections: lengths and brightnesses of known rods."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from needlefit.imaging.needle.hub import find_hub
from needlefit.imaging.needle.rod_projection import CELL_MM, COLUMN_MM, Rod
from needlefit.imaging.needle.segmentation import find_tubes
from needlefit.imaging.volume import Volume, to_index, to_patient, turn_slices
from needlefit.schemas.reconstruction import ReconstructionRecord

COLUMNS = np.arange(30.0, -30.1, -COLUMN_MM)


def make_rod(radius, thick=1.0):
    """A rod along the first direction in the middle of the second of three slices."""
    stations, side = np.array([0.0, 10.0, 34.0]), np.zeros((3, 1))
    return Rod(COLUMNS, radius, 2.0, thick, np.arange(3) * thick, stations, side, np.full(len(COLUMNS), 5.0))


@pytest.mark.parametrize("drift", [0.0, 0.05])
def test_rays_across_and_along_a_rod_pass_its_chord_and_its_length(drift):
    rod, radius = make_rod(0.635), 0.635
    stored = rod.lengths(drift * COLUMNS, np.full(len(COLUMNS), 1.0), 30.0, 0.0)
    planes = np.flatnonzero(np.diff(stored.indptr))
    metal = stored.toarray()[planes]
    away = rod.planes[planes] - 1.0
    views = np.split(metal, np.cumsum(rod.seen[1])[:-1], axis=1)
    chords = 2 * np.sqrt(np.clip(radius**2 - away**2, 0, None)) * np.sqrt(1 + drift**2)
    across = views[0][:, rod.half - rod.seen[0, 0]]  # at the origin, at right angles to the first direction
    inner = np.abs(away) < 0.7 * radius  # a plane has a thickness, over which the chord varies
    assert_allclose(across[inner], chords[inner], rtol=0.01)
    assert_allclose(across.sum() / rod.in_slice, np.pi * radius**2 * np.sqrt(1 + drift**2), rtol=1e-3)
    if drift == 0:
        along = len(rod.views[0]) // 2
        middle = views[along][np.argmin(np.abs(away)), rod.half - rod.seen[0, along]]
        assert_allclose(middle, np.ptp(COLUMNS), atol=1.5)  # less half a bevel of 0.6 mm, and half a column
        # what all rays of a view meet is the plane's area; one view looks along edges, between two cells
        area = (
            np.stack([view[inner].sum(axis=-1) for n, view in enumerate(views) if n != along], axis=1)
            * CELL_MM
        )
        assert_allclose(area, np.broadcast_to(area[:, :1], area.shape), rtol=0.01)


def test_pieces_of_a_needle_in_successive_slices_are_one_tube():
    spacing = np.array([0.4, 0.4, 2.0])
    values = np.random.default_rng(1).normal(0, 20, (8, 40, 200)).astype(np.float32)
    for n, k in enumerate(range(2, 6)):  # 9 mm of the needle in each slice, and 6 mm that rays hide
        values[k, 19:22, 20 + 38 * n : 43 + 38 * n] = 3000
    recipe = ReconstructionRecord.model_validate(
        {"schema": 2, "needle": {"length_mm": 100, "diameter_mm": 1.27, "bevel_deg": 30}}
    )
    (tube,) = find_tubes(Volume(values, np.zeros(3), spacing, np.eye(3)), recipe)
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
