"""Laws of frames, curves and comparisons: rigid invariance, known motions, straight lines, shifts."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from refusals import refusal
from scipy.spatial.transform import Rotation

from needlefit.errors import DataError
from needlefit.geometry.curves import (
    COMPARISON_POINTS,
    arc_length,
    compare_curves,
    find_bending_direction,
    fit_free_frame,
    interpolate_at_arc,
    make_normal,
)
from needlefit.geometry.frames import Frame, align_rigid, make_entry_frame
from needlefit.metrics import compute_metrics

seeds = st.integers(0, 2**32 - 1)


def arc(radius, length, points=101):
    """A circle of this radius that starts along x and bends toward +y."""
    angle = np.linspace(0, length / radius, points)
    return radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)])


def turn(curve, angle, shift=(0.0, 0.0)):
    c, s = np.cos(angle), np.sin(angle)
    return curve @ np.array([[c, s], [-s, c]]) + np.asarray(shift)


@given(seeds)
def test_a_frame_and_back_is_the_identity_and_keeps_distances(seed):
    rng = default_rng(seed)
    frame = Frame(rng.normal(size=3) * 50, Rotation.random(rng=rng).as_matrix())
    points = rng.normal(size=(20, 3)) * 80
    local = frame.to_local(points)
    assert_allclose(frame.to_world(local), points, atol=1e-10)
    assert_allclose(arc_length(local), arc_length(points), atol=1e-10)
    rng = default_rng(seed)
    direction, toward = rng.normal(size=(2, 3))
    frame = make_entry_frame((0, 0, 0), direction, toward)
    assert_allclose(frame.rotation.T @ frame.rotation, np.eye(3), atol=1e-9)
    assert np.linalg.det(frame.rotation) == approx(1)
    assert frame.to_local([toward])[0, 1] > 0
    assert frame.to_local([toward])[0, 2] == approx(0, abs=1e-9)


def test_entry_frames_arc_lengths_and_straight_curves_by_hand():
    frame = make_entry_frame((1, 2, 3), (0, 0, 2), (0, 5, 7))
    assert_allclose(frame.rotation, [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-15)
    assert_allclose(frame.to_local([[1, 2, 13], [1, 4, 3], [2, 2, 3]]), [[10, 0, 0], [0, 2, 0], [0, 0, -1]])
    corner = np.array([[0.0, 0], [3, 4], [3, 10]])
    assert_allclose(arc_length(corner), [0, 5, 11])
    assert_allclose(interpolate_at_arc(corner, [-1, 2.5, 8, 12]), [[0, 0], [1.5, 2], [3, 7], [3, 10]])
    toward = find_bending_direction([[0, 0, 0], [0, 0, 5.0], [0, 0, 9.0]], (0, 0, 1))
    assert toward @ [0, 0, 1] == 0
    assert_array_equal(toward, make_normal((0, 0, 1)))


def test_directions_without_a_plane_are_refused():
    for direction, toward in [((0, 0, 0), (0, 1, 0)), ((1, 0, 0), (2, 0, 0)), ((1, np.nan, 0), (0, 1, 0))]:
        refusal(DataError, "expected", make_entry_frame, (0, 0, 0), direction, toward)


def test_alignment_never_mirrors_or_scales():
    curve = arc(100, 60)
    mirrored = curve * [1, -1]
    aligned = align_rigid(mirrored, curve)
    assert np.abs(aligned - curve).max() > 1
    assert_allclose(arc_length(align_rigid(2 * curve, curve)), 2 * arc_length(curve), rtol=1e-12)


@given(seeds)
def test_alignment_is_the_least_squares_motion(seed):
    rng = default_rng(seed)
    moving, fixed = rng.normal(size=(2, 12, 2))
    moved = turn(fixed, moving[0, 0], 50 * moving[1])
    assert_allclose(align_rigid(moved, fixed), fixed, atol=1e-9)
    best = np.sum((align_rigid(moving, fixed) - fixed) ** 2)
    for angle, dx, dy in rng.normal(size=(10, 3)) * 0.1:
        other = turn(align_rigid(moving, fixed), angle, (dx, dy))
        assert np.sum((other - fixed) ** 2) >= best - 1e-9


@given(seeds)
def test_free_frame_is_the_same_from_everywhere(seed):
    """A parabola y = x^2 / 500 keeps its coordinates in the frame made from it, however it lies."""
    rng = default_rng(seed)
    x = np.linspace(0, 60, 61)
    parabola = np.column_stack([x, x**2 / 500, 0 * x])
    moved = parabola @ Rotation.random(rng=rng).as_matrix().T + rng.normal(size=3) * 40
    local, at_home = fit_free_frame(moved).to_local(moved), fit_free_frame(parabola).to_local(parabola)
    assert_allclose(local[:, :2], at_home[:, :2], atol=1e-8)
    assert_allclose(local[:, 2], 0, atol=1e-8)
    assert local[-1, 1] == approx(60**2 / 500, rel=0.05)  # x is nearly the tangent at the entry


def test_errors_by_hand():
    measured = np.array([[0.0, 1], [10, 1], [20, 5]])
    curves = compare_curves(measured + np.array([[0, 0], [0, 1], [3, 4]]), measured)
    assert_allclose(curves.distances, [0, 1, 5])
    expected = {"te_mm": 5, "edp_percent": 125, "median_err_mm": 1, "ipe_mean_mm": 2, "ipe_max_mm": 5}
    expected["ipe_std_mm"] = np.sqrt(14 / 3)
    found = compute_metrics(curves)
    assert {name: found[name] for name in expected} == approx(expected)
    assert curves.deflection == 4
    assert COMPARISON_POINTS == 101
    in_space = [np.column_stack([one, [0.0, 2, z]]) for one, z in ((curves.simulated, 14.0), (measured, 2.0))]
    found = compute_metrics(compare_curves(*in_space, "plane"))
    assert {name: found[name] for name in expected} == approx(expected)
    found = compute_metrics(compare_curves(*in_space, "space"))
    assert (found["te_mm"], found["ipe_mean_mm"]) == approx((13, 14 / 3))
    assert found["edp_percent"] == approx(100 * 13 / np.hypot(4, 2))
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    assert compute_metrics(compare_curves(line, line))["edp_percent"] == 0
    assert compute_metrics(compare_curves(line + np.array([0, 1]), line))["edp_percent"] == np.inf
