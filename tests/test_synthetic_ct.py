"""Rendered scans: what must be in them whatever the scanner does."""

from dataclasses import replace

import ct_cases as cases
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from needlefit.geometry.frames import Frame
from needlefit.synthetic.ct_scene import Needle3D, ScannerTable, SceneMarkers
from needlefit.synthetic.render import bevel_side, render_streaks, voxelize_balls, voxelize_needle

VOXEL = cases.SPACING**3


def test_the_voxels_hold_the_volume_of_needle_bevel_and_balls():
    blunt = Needle3D(cases.axis()[41:], bevel_deg=90.0)
    metal = voxelize_needle(blunt, cases.grid())
    length = np.linalg.norm(np.diff(blunt.points, axis=0), axis=1).sum()
    assert_allclose(metal.part.sum() * VOXEL, np.pi / 4 * 1.27**2 * length, rtol=4e-3)
    assert metal.part.min() >= 0 and metal.part.max() == 1
    center = np.array([[10.1, 11.2, 30.3]])
    metal = voxelize_balls(SceneMarkers(center, radius=1.5), cases.grid())
    assert_allclose(metal.part.sum() * VOXEL, 4 / 3 * np.pi * 1.5**3, rtol=5e-3)
    mean = (metal.part[:, None] * metal.voxels).sum(axis=0) / metal.part.sum() * cases.SPACING
    assert_allclose(mean, center[0], atol=5e-3)
    for angle in [20.0, 45.0]:
        points = cases.axis(tip=(2.0, 3.0, 28.0))[41:]
        bevelled = voxelize_needle(Needle3D(points, bevel_deg=angle), cases.grid())
        blunt = voxelize_needle(Needle3D(points, bevel_deg=90.0), cases.grid())
        cut = np.pi / 8 * 1.27**3 / np.tan(np.deg2rad(angle))
        assert_allclose((blunt.part.sum() - bevelled.part.sum()) * VOXEL, cut, rtol=0.02)
    toward = np.array([0.3, 1.0, 0.2])
    needle = Needle3D(cases.axis()[41:], bevel_toward=toward)
    metal = voxelize_needle(needle, cases.grid())
    places = metal.voxels * cases.SPACING
    end = places[:, 2] > places[:, 2].max() - 1.0
    center = (metal.part[end, None] * places[end]).sum(axis=0) / metal.part[end].sum()
    assert bevel_side(needle) @ (center - cases.ENTRY) > 0.3
    assert_allclose(bevel_side(needle)[:2], toward[:2] / np.hypot(*toward[:2]), atol=1e-6)


def test_layers_have_their_ct_numbers_and_noise_its_strength():
    volume = cases.scan(cases.axis(), noise_hu=0.0)
    column = volume.values[:, 10, 5]  # 8 mm from the needle
    depth = np.arange(len(column)) * cases.SPACING - 12.0
    assert_array_equal(column[depth < -3], -1000)
    assert_array_equal(column[(depth > 3) & (depth < 12)], 40)
    assert_array_equal(column[(depth > 16) & (depth < 30)], 90)
    face = np.interp(0.0, (column - (-480.0))[20:32], depth[20:32])
    assert abs(face) < 0.02  # half-way between air and layer 1
    values = cases.scan(cases.axis(), noise_hu=50.0, noise_mm=0.25).values[-8:, :20, :20] - 90.0
    assert_allclose(values.std(), 50.0, rtol=0.06)
    rho = np.mean(values[..., 1:] * values[..., :-1]) / values.var()
    assert 0.15 < rho < 0.6


def test_metal_saturates_blooms_and_darkens_and_equal_generators_give_equal_bytes():
    with_rays = {"streaks": 1.0, "bloom": 0.1, "cupping_hu": 60.0}
    first, second = (cases.scan(cases.axis(), seed=3, **with_rays).values for _ in range(2))
    assert_array_equal(first, second)
    assert np.any(first != cases.scan(cases.axis(), seed=4, **with_rays).values)
    sharp = cases.scan(cases.axis(), noise_hu=0.0).values
    bloomed = cases.scan(cases.axis(), noise_hu=0.0, bloom=0.15).values
    assert sharp.max() == bloomed.max() == 3071
    ring = np.s_[60, 24, 24 + 4]  # 1.8 mm from the axis
    assert bloomed[ring] > sharp[ring] + 40
    far = SceneMarkers(np.array([[100.0, 100.0, 100.0]]))  # nothing in view
    values = cases.scan(cases.axis(), noise_hu=0.0, cupping_hu=80.0, scene={"markers": far}).values
    # 8 mm off the box's axis: 80 (1 - 0.5 (8 / 40)^2) = 78.4
    x = round(3.0 / cases.SPACING)
    distance = np.hypot(11.0 - x * cases.SPACING, 11.0 - 24 * cases.SPACING)
    assert_allclose(values[-5, 24, x], 90 - 80 * (1 - 0.5 * (distance / 40) ** 2), atol=1.0)


def test_rays_lie_in_the_slices_that_hold_metal_and_the_table_under_its_frame():
    rng = np.random.default_rng(1)
    needle = voxelize_needle(Needle3D(cases.axis()[41:]), cases.grid())
    error = render_streaks([needle], cases.grid(), 120, rng)
    held = np.zeros(cases.SHAPE[2], dtype=bool)
    held[needle.voxels[:, 2]] = True
    assert np.all(error[~held] == 0)
    assert np.all(error[held].std(axis=(1, 2)) > 0)
    strong = render_streaks([replace(needle, hu=3 * needle.hu)], cases.grid(), 120, np.random.default_rng(1))
    assert strong.std() > 2 * error.std()
    frame = Frame(np.array([11.0, 18.0, 25.0]), np.array([[0.0, 1, 0], [0, 0, -1], [1, 0, 0]]))
    table = ScannerTable(frame, width=14.0, thickness=2.0)
    values = cases.scan(cases.axis(), noise_hu=0.0, scene={"table": table}).values
    row = round(19.0 / cases.SPACING)
    assert values[100, row, round(11.0 / cases.SPACING)] > 1000  # rails 8 mm wide meet in the middle of 14
    assert values[100, row, round(2.0 / cases.SPACING)] == 90
    assert values[100, round(15.5 / cases.SPACING), round(16.0 / cases.SPACING)] == 90
