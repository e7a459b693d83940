"""Arc lengths along noisy points: known lengths of arcs, whatever their spacing, noise and bend."""

import numpy as np
import pytest

from needlefit.geometry.curves import integrate_curvature
from needlefit.geometry.measured_curve import measure_curve

LENGTH = 35.0


def arc_points(s, bend, length=LENGTH):
    """Points (N, 3) at arc lengths along a curve that turns by an angle, rad."""
    return np.column_stack([integrate_curvature(length, [bend / length], s), np.zeros(len(s))])


def measure_again(points, sd, rng, repeats):
    return [measure_curve(points + sd * rng.normal(size=points.shape), sd) for _ in range(repeats)]


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("spacing", [0.1, 0.5, 1.0, 5.0])
def test_the_length_is_right_whatever_spacing_and_noise(spacing, noise):
    rng = np.random.default_rng(7)
    s = np.linspace(0, LENGTH, round(LENGTH / spacing) + 1)
    curves = measure_again(arc_points(s, 0.5), noise, rng, 6 if spacing == 0.1 else 40)
    lengths = np.array([one.length for one in curves])
    assert abs(lengths.mean() - LENGTH) < 0.1
    z = (lengths - LENGTH) / [one.length_sd for one in curves]
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.7
    assert np.mean([one.noise_sd for one in curves]) == pytest.approx(noise, rel=0.2)
    assert all((np.diff(one.s) > 0).all() for one in curves)


@pytest.mark.parametrize("count", [5, 8, 20, 200, 2000])
@pytest.mark.parametrize("bend", [0.0, 0.3, np.pi / 2])
def test_curves_without_noise_have_the_length_of_the_arc(count, bend):
    curve = measure_curve(arc_points(s := np.linspace(0, LENGTH, count), bend))
    np.testing.assert_allclose(curve.s, s, atol=5e-3 if count == 5 else 2e-4)
    assert curve.noise_sd < 2e-3
