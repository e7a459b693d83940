"""Volumes rendered in projection space: chords of solids, attenuation, saturation, determinism."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from projection import (
    ALUMINIUM,
    CLIPPED_HU,
    EXTENDED_HU,
    KERNELS,
    STEEL,
    WATER,
    Box,
    Detector,
    Ellipsoid,
    Gantry,
    Kernel,
    ProjectionScene,
    Rays,
    Rod,
    attenuation,
    back_project,
    filter_projections,
    interval_length,
    make_ball,
    make_needle,
    measure_slices,
    render_volume,
    tungsten_spectrum,
)
from scipy.ndimage import gaussian_filter1d
from skimage.transform import iradon

from needlefit.geometry.frames import Frame
from needlefit.imaging.volume import VoxelGrid

UPRIGHT = Frame(np.zeros(3), np.eye(3))
PHANTOM = Rod(np.array([0, 0, -20.0]), np.array([0, 0, 20.0]), 20.0, WATER)
QUIET = Gantry(views=180, photons=1e8, electronic_sd=0.0, scatter=0.0)


def rays(angle=0.3, t=None, z=0.0):
    """Rays of one view; those at t = 0 run through the origin."""
    t = np.linspace(-4, 4, 81) if t is None else np.asarray(t)
    return Rays(UPRIGHT, np.array([[np.cos(angle)]]), np.array([[np.sin(angle)]]), t[None], np.array(z))


def grid(half=6, spacing=0.5, slices=2):
    """Square slices about the origin."""
    n = 2 * half + 1
    low = np.array([-half * spacing, -half * spacing, 0.0])
    return VoxelGrid((n, n, slices), low, np.full(3, spacing), np.eye(3))


def chord(solid, some):
    return interval_length([solid.interval(some)])[0]


def test_balls_boxes_and_rods_are_cut_by_their_chords():
    some = rays(z=0.5)
    expected = 2 * np.sqrt(np.clip(1.5**2 - 0.5**2 - some.t[0] ** 2, 0, None))
    assert_allclose(chord(make_ball(np.zeros(3), 3.0, STEEL), some), expected, atol=1e-12)
    t = np.linspace(-4, 4, 400)
    bone = Ellipsoid(UPRIGHT, np.array([3.0, 2.0, 1.0]), WATER)
    area = sum(chord(bone, rays(0.7, t, z)).sum() for z in np.linspace(-1, 1, 101)) * (t[1] - t[0]) * 0.02
    assert_allclose(area, 4 / 3 * np.pi * 6, rtol=2e-3)
    for angle in [0.0, 0.4, np.pi / 2]:
        some = rays(angle, t=[0.0, 0.2])
        box = Box(UPRIGHT, np.array([-1, -2, -3.0]), np.array([1, 2, 3.0]), WATER)
        along = np.array([-np.sin(angle), np.cos(angle)])
        with np.errstate(divide="ignore"):
            assert_allclose(chord(box, some)[0], 2 * np.min(np.array([1, 2]) / np.abs(along)), rtol=1e-9)
        way = np.array([0.0, 0.6, 0.8])
        rod = Rod(-9 * way, 9 * way, 0.5, STEEL)
        sine = np.sqrt(1 - (along @ way[:2]) ** 2)
        assert_allclose(chord(rod, some)[0], 1.0 / sine, rtol=1e-9)


def test_a_bent_bevelled_needle_has_the_volume_of_its_axis():
    s = np.linspace(0, 20, 21)
    points = np.column_stack([0.004 * s**2, 0 * s, s - 10])
    needle = make_needle(points, 1.2, 30.0, np.array([0.0, 1.0, 0.0]), STEEL)
    t = np.linspace(-2, 2, 161)
    heights = np.linspace(-11, 11, 221)
    held = sum(chord(rod, rays(0.7, t, z)).sum() for rod in needle for z in heights) * 0.025 * 0.1
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    cut = np.pi * 0.6**3 / np.tan(np.radians(30))
    assert_allclose(held, np.pi * 0.6**2 * length - cut, rtol=5e-3)


def test_metal_displaces_what_it_lies_in_and_attenuation_follows_the_tables():
    ball = make_ball(np.zeros(3), 3.0, WATER)
    plain, filled = (
        next(iter(measure_slices(scene, QUIET, UPRIGHT, np.zeros(1), np.random.default_rng(3))))
        for scene in (ProjectionScene((PHANTOM,)), ProjectionScene((PHANTOM,), (), (ball,)))
    )
    assert_allclose(filled, plain, atol=0.02)
    assert_allclose(attenuation(WATER, np.array([60.0])), [0.02059], rtol=1e-6)
    assert_allclose(attenuation(STEEL, np.array([60.0]))[0], 0.79 * (0.71 * 1.205 + 0.19 * 0.9639 + 0.1512))
    spectrum = tungsten_spectrum(120.0)
    mean = spectrum.energies_kev @ spectrum.weights
    assert_allclose(spectrum.weights.sum(), 1)
    assert 60 < mean < 75
    assert attenuation(ALUMINIUM, np.array([35.0])) > attenuation(ALUMINIUM, np.array([75.0]))


@pytest.mark.parametrize("source_mm", [None, 570.0])
@pytest.mark.parametrize("kernel", KERNELS)
def test_water_reads_zero(kernel, source_mm):
    gantry = Gantry(views=180, scatter=0.0, source_mm=source_mm)
    volume = render_volume(
        ProjectionScene((PHANTOM,)),
        gantry,
        grid(slices=2),
        KERNELS[kernel],
        CLIPPED_HU,
        np.random.default_rng(1),
    )
    noise = volume.values.std()
    assert 0.5 < noise < 40
    assert abs(volume.values.mean()) < 1.5


def test_noise_falls_with_dose():
    few, many = (
        render_volume(
            ProjectionScene((PHANTOM,)),
            Gantry(views=180, photons=n, electronic_sd=0.0),
            grid(),
            KERNELS["standard"],
            CLIPPED_HU,
            np.random.default_rng(1),
        ).values.std()
        for n in (1e4, 1e6)
    )
    assert_allclose(few / many, 10, rtol=0.25)


def test_steel_is_clipped_where_the_scale_ends_and_a_bone_kernel_undershoots():
    scene = ProjectionScene((PHANTOM,), (), (make_ball(np.zeros(3), 3.0, STEEL),))
    whole, clipped = (
        render_volume(scene, QUIET, grid(12, 0.25), KERNELS["standard"], top, np.random.default_rng(2))
        for top in (EXTENDED_HU, CLIPPED_HU)
    )
    energy = np.array([60.0])
    true = 1000 * (attenuation(STEEL, energy) / attenuation(WATER, energy) - 1)[0]
    assert clipped.values.max() == CLIPPED_HU
    assert np.count_nonzero(clipped.values == CLIPPED_HU) > 100
    assert 0.3 * true < whole.values.max() < true
    soft, edge = (
        render_volume(
            scene, QUIET, grid(12, 0.25), KERNELS[name], EXTENDED_HU, np.random.default_rng(2)
        ).values[0, 12]
        for name in ("soft", "edge")
    )
    assert edge.min() < -900 < soft.min()
    assert edge.max() > soft.max()


def test_back_projection_agrees_with_scikit_image():
    t = np.arange(-40, 40) * 0.5
    gantry = Gantry(views=180, cell_mm=0.5)
    ball = make_ball(np.array([3.0, -2.0, 0.0]), 12.0, WATER)
    angles = np.arange(180) * np.pi / 180
    sharp = np.array([chord(ball, rays(angle, t)) for angle in angles])
    sinogram = gaussian_filter1d(sharp, 1.5, axis=1)  # how they interpolate makes no difference then
    fine = filter_projections(sinogram, 0.5, Kernel(1e3)).astype(np.float32)
    detector = Detector(t, angles)
    mine = back_project(fine[None], detector, gantry, grid(16), np.array([-8.0, -8.0, 0.0]))[0]
    theirs = iradon(sinogram.T / 0.5, np.arange(180), filter_name="ramp", circle=True)
    assert_allclose(mine, theirs[::-1][23:56, 24:57], atol=0.02)


def test_equal_generators_give_equal_bytes():
    scene = ProjectionScene((PHANTOM,), (), (make_ball(np.array([5.0, 0, 0]), 2.0, STEEL),))
    one, other = (
        render_volume(
            scene,
            Gantry(views=90, source_mm=500.0),
            grid(),
            KERNELS["bone"],
            CLIPPED_HU,
            np.random.default_rng(7),
        )
        for _ in range(2)
    )
    assert_array_equal(one.values, other.values)
