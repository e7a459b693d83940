"""A volume that was rendered in projection space, reconstructed: tip, entry, layer and world are as drawn."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from projection import (
    CLIPPED_HU,
    KERNELS,
    MUSCLE,
    STEEL,
    TITANIUM,
    WATER,
    Box,
    Gantry,
    ProjectionScene,
    make_ball,
    make_needle,
    render_volume,
)
from scipy.spatial.transform import Rotation

from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import make_sheet, write_surface
from needlefit.imaging.reconstruct import examine
from needlefit.imaging.scans import LayerSource, Scan
from needlefit.imaging.volume import VoxelGrid
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.synthetic.render import densify

WORLD = Frame(
    np.array([12.0, -30.0, 50.0]),
    Rotation.from_euler("xz", [3.0, -2.0], degrees=True).as_matrix()
    @ np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
)
"""The world in the scan: its x axis runs into the tissue, about along the slices' normal."""

INTERFACE_MM = 11.0
BALLS = np.array([[5.0, 9, -6], [8, -10, 5], [16, -8, -9], [22, 10, 7], [26, -4, 11]])


def needle_axis():
    """A needle from 25 mm before the face to a depth of 24 mm along x; the tip moves 1.5 mm toward +y."""
    x = np.linspace(-25.0, 24.0, 60)
    part = np.clip(x, 0, None) / 24.0
    return np.column_stack([x, 1.5 * (1.5 * part**2 - 0.5 * part**3), 0.01 * x])


def render():
    """Return the volume of a steel needle in two layers, with balls of titanium and steel."""
    layers = tuple(
        Box(WORLD, np.array([low, -16.0, -16]), np.array([high, 16.0, 16]), material)
        for low, high, material in ((0, INTERFACE_MM, WATER), (INTERFACE_MM, 34, MUSCLE))
    )
    needle = make_needle(WORLD.to_world(needle_axis()), 1.27, 30.0, WORLD.rotation[:, 1], STEEL)
    metals = [TITANIUM, STEEL, TITANIUM, TITANIUM, STEEL]
    balls = [make_ball(at, 3.0, metal) for at, metal in zip(WORLD.to_world(BALLS), metals, strict=True)]
    return render_volume(
        ProjectionScene(layers, (), (*needle, *balls)),
        Gantry(views=360, slice_mm=0.6),
        VoxelGrid(
            (60, 60, 83), WORLD.origin - np.array([15.0, 15.0, 18.0]), np.array([0.5, 0.5, 0.6]), np.eye(3)
        ),
        KERNELS["standard"],
        CLIPPED_HU,
        np.random.default_rng(3),
    )


@pytest.mark.sweep
def test_a_volume_of_projections_is_reconstructed(tmp_path):
    lines = ["x_mm,y_mm,z_mm", *(",".join(map(str, place)) for place in BALLS)]
    (tmp_path / "known.csv").write_text("\n".join(lines) + "\n")
    sheet = make_sheet("layer2", (INTERFACE_MM, 0, 0), (1, 0, 0), 60.0, into=2)
    write_surface(sheet, tmp_path / "layer2.stl")
    layer = LayerSource(tmp_path / "layer2.stl", "sheet", 2)
    scan = Scan("one", tmp_path / "one.nrrd", "gel", markers=tmp_path / "known.csv", surfaces=(layer,))
    found = examine(render(), scan, ReconstructionRecord(schema=2))
    assert found.error is None, found.error
    one = found.reconstruction
    seen = WORLD.to_local(found.markers.centers)
    apart = np.linalg.norm(seen[:, None] - BALLS, axis=2)
    assert apart.min(axis=1).max() < 0.03 and sorted(apart.argmin(axis=1)) == [0, 1, 2, 3, 4]
    assert one.registration.fre < 0.03
    truth = densify(needle_axis())
    inside = truth[truth[:, 0] >= 0]
    way = (truth[-1] - truth[-20]) / np.linalg.norm(truth[-1] - truth[-20])
    off = one.points[-1] - truth[-1]
    assert abs(off @ way) < 3 * one.needle_axis.tip_sd[0] < 0.3
    assert np.linalg.norm(off - (off @ way) * way) < 0.25
    assert abs(one.points[0, 0]) < 0.2
    assert abs(one.depth - arc_length(inside)[-1]) < 0.2
    assert one.layers.sequence == (1, 2)
    assert_allclose(one.layers.boundaries, [INTERFACE_MM], atol=0.1)
