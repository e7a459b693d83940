"""Volumes rendered in projection space: chords of solids, attenuation, saturation, determinism."""

import numpy as np
import projection
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter1d
from skimage.transform import iradon

from needlefit.geometry.frames import Frame
from needlefit.imaging.volume import VoxelGrid

UPRIGHT = Frame(np.zeros(3), np.eye(3))
PHANTOM = projection.Rod(np.array([0, 0, -20.0]), np.array([0, 0, 20.0]), 20.0, projection.WATER)
QUIET = projection.Gantry(views=180, photons=1e8, electronic_sd=0.0, scatter=0.0)


def rays(angle=0.3, t=None, z=0.0):
    """Rays of one view; those at t = 0 run through the origin."""
    t = np.linspace(-4, 4, 81) if t is None else np.asarray(t)
    return projection.Rays(
        UPRIGHT, np.array([[np.cos(angle)]]), np.array([[np.sin(angle)]]), t[None], np.array(z)
    )


def grid(half=6, spacing=0.5, slices=2):
    """Square slices about the origin."""
    n = 2 * half + 1
    low = np.array([-half * spacing, -half * spacing, 0.0])
    return VoxelGrid((n, n, slices), low, np.full(3, spacing), np.eye(3))


def chord(solid, some):
    return projection.interval_length([solid.interval(some)])[0]


def test_balls_boxes_and_rods_are_cut_by_their_chords():
    some = rays(z=0.5)
    expected = 2 * np.sqrt(np.clip(1.5**2 - 0.5**2 - some.t[0] ** 2, 0, None))
    assert_allclose(
        chord(projection.make_ball(np.zeros(3), 3.0, projection.STEEL), some), expected, atol=1e-12
    )
    t = np.linspace(-4, 4, 400)
    bone = projection.Ellipsoid(UPRIGHT, np.array([3.0, 2.0, 1.0]), projection.WATER)
    area = sum(chord(bone, rays(0.7, t, z)).sum() for z in np.linspace(-1, 1, 101)) * (t[1] - t[0]) * 0.02
    assert_allclose(area, 4 / 3 * np.pi * 6, rtol=2e-3)
    for angle in [0.0, 0.4, np.pi / 2]:
        some = rays(angle, t=[0.0, 0.2])
        box = projection.Box(UPRIGHT, np.array([-1, -2, -3.0]), np.array([1, 2, 3.0]), projection.WATER)
        along = np.array([-np.sin(angle), np.cos(angle)])
        with np.errstate(divide="ignore"):
            assert_allclose(chord(box, some)[0], 2 * np.min(np.array([1, 2]) / np.abs(along)), rtol=1e-9)
        way = np.array([0.0, 0.6, 0.8])
        rod = projection.Rod(-9 * way, 9 * way, 0.5, projection.STEEL)
        sine = np.sqrt(1 - (along @ way[:2]) ** 2)
        assert_allclose(chord(rod, some)[0], 1.0 / sine, rtol=1e-9)


def test_a_bent_bevelled_needle_has_the_volume_of_its_axis():
    s = np.linspace(0, 20, 21)
    points = np.column_stack([0.004 * s**2, 0 * s, s - 10])
    needle = projection.make_needle(points, 1.2, 30.0, np.array([0.0, 1.0, 0.0]), projection.STEEL)
    t = np.linspace(-2, 2, 161)
    heights = np.linspace(-11, 11, 221)
    held = sum(chord(rod, rays(0.7, t, z)).sum() for rod in needle for z in heights) * 0.025 * 0.1
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    cut = np.pi * 0.6**3 / np.tan(np.radians(30))
    assert_allclose(held, np.pi * 0.6**2 * length - cut, rtol=5e-3)


def test_metal_displaces_what_it_lies_in_and_attenuation_follows_the_tables():
    ball = projection.make_ball(np.zeros(3), 3.0, projection.WATER)
    plain, filled = (
        next(iter(projection.measure_slices(scene, QUIET, UPRIGHT, np.zeros(1), np.random.default_rng(3))))
        for scene in (
            projection.ProjectionScene((PHANTOM,)),
            projection.ProjectionScene((PHANTOM,), (), (ball,)),
        )
    )
    assert_allclose(filled, plain, atol=0.02)
    assert_allclose(projection.attenuation(projection.WATER, np.array([60.0])), [0.02059], rtol=1e-6)
    assert_allclose(
        projection.attenuation(projection.STEEL, np.array([60.0]))[0],
        0.79 * (0.71 * 1.205 + 0.19 * 0.9639 + 0.1512),
    )
    spectrum = projection.tungsten_spectrum(120.0)
    mean = spectrum.energies_kev @ spectrum.weights
    assert_allclose(spectrum.weights.sum(), 1)
    assert 60 < mean < 75
    assert projection.attenuation(projection.ALUMINIUM, np.array([35.0])) > projection.attenuation(
        projection.ALUMINIUM, np.array([75.0])
    )


@pytest.mark.parametrize("source_mm", [None, 570.0])
@pytest.mark.parametrize("kernel", projection.KERNELS)
def test_water_reads_zero(kernel, source_mm):
    gantry = projection.Gantry(views=180, scatter=0.0, source_mm=source_mm)
    volume = projection.render_volume(
        projection.ProjectionScene((PHANTOM,)),
        gantry,
        grid(slices=2),
        projection.KERNELS[kernel],
        projection.CLIPPED_HU,
        np.random.default_rng(1),
    )
    noise = volume.values.std()
    assert 0.5 < noise < 40
    assert abs(volume.values.mean()) < 1.5


def test_back_projection_agrees_with_scikit_image():
    t = np.arange(-40, 40) * 0.5
    gantry = projection.Gantry(views=180, cell_mm=0.5)
    ball = projection.make_ball(np.array([3.0, -2.0, 0.0]), 12.0, projection.WATER)
    angles = np.arange(180) * np.pi / 180
    sharp = np.array([chord(ball, rays(angle, t)) for angle in angles])
    sinogram = gaussian_filter1d(sharp, 1.5, axis=1)  # how they interpolate makes no difference then
    fine = projection.filter_projections(sinogram, 0.5, projection.Kernel(1e3)).astype(np.float32)
    detector = projection.Detector(t, angles)
    mine = projection.back_project(fine[None], detector, gantry, grid(16), np.array([-8.0, -8.0, 0.0]))[0]
    theirs = iradon(sinogram.T / 0.5, np.arange(180), filter_name="ramp", circle=True)
    assert_allclose(mine, theirs[::-1][23:56, 24:57], atol=0.02)
