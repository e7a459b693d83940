"""Arc lengths along noisy points: known lengths of arcs, whatever their spacing, noise and bend."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from needlefit.geometry.curves import arc_length, integrate_curvature
from needlefit.geometry.measured_curve import measure_curve

LENGTH = 35.0


def arc_points(s, bend):
    """Points (N, 3) at arc lengths along a curve that turns by an angle, rad."""
    return np.column_stack([integrate_curvature(LENGTH, [bend / LENGTH], s), np.zeros(len(s))])


@pytest.mark.parametrize(("spacing", "noise"), [(0.1, 0.05), (0.5, 0.1), (1.0, 0.2), (5.0, 0.1)])
def test_the_length_is_right_whatever_spacing_and_noise(spacing, noise):
    rng = default_rng(7)
    s = np.linspace(0, LENGTH, round(LENGTH / spacing) + 1)
    points, repeats = arc_points(s, 0.5), 6 if spacing == 0.1 else 40
    curves = [measure_curve(points + noise * rng.normal(size=points.shape), noise) for _ in range(repeats)]
    lengths = np.array([one.length for one in curves])
    assert abs(lengths.mean() - LENGTH) < 0.1
    z = (lengths - LENGTH) / [one.length_sd for one in curves]
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.7
    assert np.mean([one.noise_sd for one in curves]) == pytest.approx(noise, rel=0.2)
    assert all((np.diff(one.s) > 0).all() for one in curves)


@pytest.mark.parametrize(("count", "bend"), [(5, 0.3), (8, np.pi / 2), (20, 0.0), (2000, np.pi / 2)])
def test_curves_without_noise_have_the_length_of_the_arc(count, bend):
    curve = measure_curve(arc_points(s := np.linspace(0, LENGTH, count), bend))
    assert_allclose(curve.s, s, atol=5e-3 if count == 5 else 2e-4)
    assert curve.noise_sd < 2e-3


def check_lengths(points, truth, noise, along=1.0):
    """Measure points again and again: no bias beyond 0.1 mm, and errors as large as their SD, or smaller."""
    rng = default_rng(11)
    scale = noise * np.array([along, 1.0, 1.0])
    curves = [measure_curve(points + scale * rng.normal(size=points.shape), noise) for _ in range(30)]
    gaps = np.array([one.length - truth for one in curves])
    assert abs(gaps.mean()) < 0.1
    assert np.sqrt(np.mean((gaps / [one.length_sd for one in curves]) ** 2)) < 1.7
    return curves


def turned_points(s):
    """A needle that bends by 0.36 rad in one plane, then as much in the other: exact points, dense sums."""
    fine = np.linspace(0, 60, 60001)
    y, z = 0.012 * np.minimum(fine, 30.0), 0.012 * np.maximum(fine - 30.0, 0.0)
    tangents = np.column_stack([np.cos(y) * np.cos(z), np.sin(y) * np.cos(z), np.sin(z)])
    path = np.vstack([np.zeros(3), np.cumsum(0.5e-3 * (tangents[1:] + tangents[:-1]), axis=0)])
    return np.column_stack([np.interp(s, fine, axis) for axis in path.T])


@pytest.mark.parametrize("spacing", [0.2, 1.0, 5.0])
def test_a_needle_turned_on_its_way_has_its_length_in_space(spacing):
    s = np.linspace(0, 60, round(60 / spacing) + 1)
    curves = check_lengths(turned_points(s), 60.0, 0.1)
    assert np.mean([np.abs(one.s - s).max() for one in curves]) < 0.2


def test_points_per_slice_have_no_noise_along_the_needle_and_may_end_within_a_slice():
    """Slices 1 mm apart, and the tip 0.3 mm behind the last."""
    at = np.append(np.arange(0.0, 33.0), 32.3)
    x = np.arcsin(at / 70.0) * 70.0  # arc lengths of a circle of 70 mm at these places along its tangent
    check_lengths(arc_points(x, 0.5), x[-1], 0.05, along=0.0)


def test_uneven_points_and_clusters_are_not_taken_as_even():
    rng = default_rng(2)
    uneven = np.sort(np.append(rng.uniform(0, LENGTH, 30), [0, LENGTH]))
    near = np.linspace(0.3, LENGTH - 0.3, 8)[:, None] + 0.1 * np.arange(-3, 4)
    for s in (uneven, near.ravel() - near.min()):
        check_lengths(arc_points(s, np.pi / 2), np.ptp(s), 0.1)


@pytest.mark.parametrize(("along", "kept"), [(0.1, False), (0.2, True)])
def test_places_that_vary_more_along_the_needle_than_across_it_are_kept(along, kept):
    rng = default_rng(7)
    x = np.arange(60.0) + along * rng.normal(size=60)
    s = measure_curve(np.column_stack([x, 0.1 * rng.normal(size=60)])).s
    moved = np.std((s - (x - x[0]))[1:-1])
    assert bool(moved < 0.02) == kept


def test_repeated_points_and_few_points_have_places_and_motions_change_nothing():
    points = arc_points(np.linspace(0, LENGTH, 12), 0.4)
    points = points + 0.1 * default_rng(5).normal(size=points.shape)
    whole = measure_curve(points)
    twice = measure_curve(np.repeat(points, 2, axis=0))
    assert_array_equal(twice.s, np.repeat(whole.s, 2))
    assert twice.length_sd == whole.length_sd
    moved = Rotation.from_rotvec([0.3, -1.0, 0.7]).apply(3.0 * points) + np.array([50.0, -20.0, 7.0])
    assert_allclose(measure_curve(moved).s, 3 * whole.s, rtol=1e-6)
    few = measure_curve(points[:3], 0.1)
    assert_allclose(few.s, arc_length(points[:3]))
    assert few.length_sd == pytest.approx(0.1 * np.sqrt(2)) and few.noise_sd == 0.0
