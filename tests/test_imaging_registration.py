"""Laws of marker registration: known poses, invariances, closed forms of the target error, closest points."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from needlefit.geometry.frames import Frame
from needlefit.imaging.registration.register import (
    predict_mean_target_error,
    register,
    scan_frame,
    target_covariance,
    to_world,
)
from needlefit.imaging.registration.rigid import (
    fit_kabsch,
    make_marker_sets,
    pair_by_icp,
    sum_squared_residuals,
)

seeds = st.integers(0, 2**32 - 1)

LAYOUT = np.array(
    [[5, -40, -31], [22, 40, -18], [41, -40, 24], [58, 21, 40], [76, 40, 27], [80, -33, -38]], dtype=float
)
SQUARE = np.array([[20, 20, 0], [-20, 20, 0], [-20, -20, 0], [20, -20, 0]], dtype=float)
ITSELF = [[n, n] for n in range(4)]


def pose_of(rng):
    return Frame(rng.normal(size=3) * 100, Rotation.random(rng=rng).as_matrix())


def same(registration, pose, tolerance):
    points = np.array([[0, 0, 0], [75, 4, 0], [0, 50, 50]], dtype=float)
    moved = to_world(registration, pose.to_local(points))
    return np.abs(moved - points).max() < tolerance


def proper(rotation):
    return abs(np.linalg.det(rotation) - 1) < 1e-12 and np.allclose(
        rotation @ rotation.T, np.eye(3), atol=1e-12
    )


# known poses


@settings(max_examples=30)
@given(seeds)
def test_exact_markers_in_any_order_give_the_pose_exactly(seed):
    rng = np.random.default_rng(seed)
    pose, order = pose_of(rng), rng.permutation(6)
    registration = register(pose.to_local(LAYOUT)[order], LAYOUT, 0.1)
    assert registration.pairs[:, 1].tolist() == order.tolist()
    assert same(registration, pose, 1e-9)
    assert proper(registration.rotation)
    assert registration.fre < 1e-9
    assert registration.warnings == ()
    assert np.all(registration.leave_one_out < 1e-9)


@settings(max_examples=20)
@given(seeds)
def test_moving_the_scan_or_the_world_moves_the_answer_with_it(seed):
    rng = np.random.default_rng(seed)
    pose, other = pose_of(rng), pose_of(rng)
    found = pose.to_local(LAYOUT) + 0.1 * rng.normal(size=(6, 3))
    first = register(found, LAYOUT, 0.1)
    second = register(other.to_world(found), LAYOUT, 0.1)
    third = register(found, other.to_world(LAYOUT), 0.1)
    assert np.allclose(second.rotation @ other.rotation, first.rotation, atol=1e-9)
    assert np.allclose(to_world(third, found), other.to_world(to_world(first, found)), atol=1e-8)
    for one in (second, third):
        assert one.fre == pytest.approx(first.fre)
        assert one.p_value == pytest.approx(first.p_value)
        assert np.linalg.eigvalsh(one.covariance) == pytest.approx(np.linalg.eigvalsh(first.covariance))


def test_missing_spurious_and_moved_markers_are_left_out_and_named():
    rng = np.random.default_rng(3)
    pose = pose_of(rng)
    found = pose.to_local(np.concatenate([LAYOUT[:5], [[10, 10, 10]]])) + 0.05 * rng.normal(size=(6, 3))
    registration = register(found, LAYOUT, 0.05)
    assert registration.pairs.tolist() == [[n, n] for n in range(5)]
    assert "found markers 5" in registration.warnings[0]
    assert "known markers 5" in registration.warnings[1]
    moved = LAYOUT.copy()
    moved[3] += [0, 0, 2.0]
    registration = register(moved, LAYOUT, 0.05)
    assert 3 not in registration.pairs[:, 0]
    assert any(
        re.search(r"found marker 3 .*\b2\.00 mm .*known marker 3", text) for text in registration.warnings
    )
    moved = LAYOUT.copy()
    moved[3] += [0, 0, 0.3]
    registration = register(moved, LAYOUT, 0.1)
    assert registration.leave_one_out[3] == pytest.approx(0.3, abs=1e-9)
    assert np.isnan(register(LAYOUT[:3], LAYOUT[:3], 0.1).leave_one_out).all()


def test_kabsch_never_reflects_and_meets_a_marker_that_alone_has_weight():
    frame = fit_kabsch(LAYOUT * [1, 1, -1], LAYOUT, np.ones(6))
    assert proper(frame.rotation)
    left = np.sum((LAYOUT - frame.to_world(LAYOUT * [1, 1, -1])) ** 2)
    assert sum_squared_residuals((LAYOUT * [1, 1, -1])[None], LAYOUT[None], np.ones((1, 6)))[
        0
    ] == pytest.approx(left)
    assert left > 100
    moving = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]], dtype=float)
    weights = np.array([2.0, 1e-12, 1e-12])
    fixed = moving + np.array([[3, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert fit_kabsch(moving, fixed, weights).to_world(moving[:1])[0] == pytest.approx([3, 0, 0], abs=1e-6)


def test_precise_markers_and_axes_count_for_more_than_loose_ones():
    loose = LAYOUT.copy()
    loose[0] += [0.5, 0, 0]
    sd = np.array([1.0, 0.01, 0.01, 0.01, 0.01, 0.01])
    registration = register(loose, LAYOUT, sd)
    assert np.abs(registration.residuals[1:]).max() < 1e-3
    assert registration.residuals[0] == pytest.approx([-0.5, 0, 0], abs=1e-3)
    # Errors along the loose axis of the scan alone hardly reach the pose.
    rng = np.random.default_rng(5)
    noise = np.zeros((6, 3))
    noise[:, 2] = 0.3 * rng.normal(size=6)
    sharp = register(LAYOUT + noise, LAYOUT, np.tile([0.01, 0.01, 0.3], (6, 1)))
    blunt = register(LAYOUT + noise, LAYOUT, 0.3)
    angle = [np.linalg.norm(Rotation.from_matrix(r.rotation).as_rotvec()) for r in (sharp, blunt)]
    assert angle[0] < angle[1] / 3


def test_deviations_are_one_number_or_of_each_marker_and_axis_or_covariances():
    variances = np.array([[1.0, 4, 9], [1, 4, 9], [4, 4, 4]])
    covariances = variances[:, :, None] * np.eye(3)
    for sd, expected in (
        (2.0, np.full((3, 3), 4.0)),
        ([1.0, 2, 3], np.array([[1.0] * 3, [4.0] * 3, [9.0] * 3])),
        (np.sqrt(variances), variances),
        (covariances, variances),
    ):
        sets = make_marker_sets(LAYOUT[:3], LAYOUT[:3], sd, 0.0)
        assert sets.found_covariance == pytest.approx(expected[:, :, None] * np.eye(3))
    assert sets.variance_bound == pytest.approx(np.array([[9.0] * 3, [9.0] * 3, [4.0] * 3]))
    assert sets.typical_sd == pytest.approx(np.sqrt(14 / 3))
    assert sets.extent == pytest.approx(np.sqrt(19**2 + 80**2 + 42**2))


# predicted errors


def root_mean_square(registration, point):
    return np.sqrt(np.trace(target_covariance(registration, [point])[0]))


def test_the_error_of_a_square_is_the_closed_form():
    """Half-side a: f_1^2 = f_2^2 = a^2, f_3^2 = 2 a^2; at height h over the centre d_1 = d_2 = h, d_3 = 0.

    TRE^2 = 3 sigma^2 / 4 (1 + 2 h^2 / (3 a^2)).
    """
    sigma, a = 0.2, 20.0
    registration = register(SQUARE, SQUARE, sigma, pairs=ITSELF)
    for height in (0.0, 20.0, 75.0):
        expected = np.sqrt(3 * sigma**2 / 4 * (1 + 2 * height**2 / (3 * a**2)))
        assert root_mean_square(registration, [0, 0, height]) == pytest.approx(expected)
    # in the plane, at distance d along x: d_1 = 0, d_2 = d_3 = d
    d = 60.0
    expected = np.sqrt(3 * sigma**2 / 4 * (1 + (d**2 / a**2 + d**2 / (2 * a**2)) / 3))
    assert root_mean_square(registration, [d, 0, 0]) == pytest.approx(expected)


def test_the_error_at_the_centre_is_the_noise_over_the_root_of_the_number():
    registration = register(SQUARE, SQUARE, 0.3, 0.4, pairs=ITSELF)  # hypot: 0.5
    assert target_covariance(registration, [[0, 0, 0]])[0] == pytest.approx(np.eye(3) * 0.25 / 4)
    # a Gaussian in three directions has the mean length sqrt(8 / pi) sigma
    assert predict_mean_target_error(registration, [[0, 0, 0]])[0] == pytest.approx(np.sqrt(8 / np.pi) * 0.25)
    # E FRE^2 = (1 - 2 / N) FLE^2 (R. Sibson 1979), FLE^2 = 3 sigma^2.
    registration = register(LAYOUT, LAYOUT, 0.2)
    assert registration.expected_fre == pytest.approx(np.sqrt((1 - 2 / 6) * 3 * 0.2**2))
    # At the centre of equally noisy markers, the error is a mean: each axis keeps its own variance.
    registration = register(SQUARE, SQUARE, np.tile([0.1, 0.1, 0.6], (4, 1)), pairs=ITSELF)
    expected = np.diag([0.01, 0.01, 0.36]) / 4
    assert target_covariance(registration, [[0, 0, 0]])[0] == pytest.approx(expected)
    turn = Frame(np.zeros(3), Rotation.from_euler("x", 90, degrees=True).as_matrix())  # scan z is world -y
    registration = register(turn.to_local(SQUARE), SQUARE, np.tile([0.1, 0.1, 0.6], (4, 1)), pairs=ITSELF)
    assert np.diag(target_covariance(registration, [[0, 0, 0]])[0]) == pytest.approx(
        np.array([0.01, 0.36, 0.01]) / 4
    )


def test_predicted_errors_are_those_of_many_draws():
    """200 draws, unequal noise along the axes: chi-squared of each target over 3, to 5 standard errors."""
    rng = np.random.default_rng(11)
    sd, targets = np.tile([0.05, 0.1, 0.3], (6, 1)), np.array([[0, 0, 0], [75, 4, 0]], dtype=float)
    errors, chances = [], []
    for _ in range(200):
        pose = pose_of(rng)
        found = pose.to_local(LAYOUT) + sd * rng.normal(size=(6, 3))
        registration = register(found, LAYOUT, sd, pairs=[[n, n] for n in range(6)])
        local = pose.to_local(targets)
        inverse = np.linalg.inv(target_covariance(registration, local))
        off = to_world(registration, local) - targets
        errors.append(np.einsum("ni,nij,nj->n", off, inverse, off) / 3)
        chances.append(registration.p_value)
    assert np.mean(errors, axis=0) == pytest.approx([1, 1], abs=5 * np.sqrt(2 / 3 / 200))
    assert np.mean(chances) == pytest.approx(0.5, abs=5 / np.sqrt(12 * 200))


# closest points


def test_closest_points_keep_the_pairs_of_a_near_pose_and_drop_the_spurious():
    rng = np.random.default_rng(2)
    rough = Frame(np.array([3.0, -2, 1]), Rotation.from_rotvec([0.05, 0.05, -0.05]).as_matrix())
    found = np.concatenate([LAYOUT[[4, 2, 0, 1, 5]] + 0.1 * rng.normal(size=(5, 3)), [[40, 0, 0]]])
    pairs = pair_by_icp(make_marker_sets(found, LAYOUT, 0.1, 0.0), rough)
    assert pairs.tolist() == [[0, 4], [1, 2], [2, 0], [3, 1], [4, 5]]
    pose = pose_of(np.random.default_rng(1))
    sets = make_marker_sets(pose.to_local(LAYOUT), LAYOUT, [0.1, 0.1, 0.1, 3.0, 3.0, 3.0], 0.1)
    turned = Rotation.from_rotvec([0.1, -0.05, 0.1]).as_matrix() @ pose.rotation
    assert pair_by_icp(sets, Frame(pose.origin, turned)).tolist() == [[n, n] for n in range(6)]


def test_a_rough_pose_settles_what_a_symmetric_layout_leaves_open():
    rough = Frame(np.array([1.0, 2, -1]), Rotation.from_rotvec([0.1, 0, 0.1]).as_matrix())
    registration = register(SQUARE, SQUARE, 0.1, rough=rough)
    assert np.allclose(registration.rotation, np.eye(3), atol=1e-9)
    half = Frame(np.array([1.0, 2, -1]), np.diag([-1.0, -1.0, 1.0]) @ rough.rotation)
    assert np.allclose(register(SQUARE, SQUARE, 0.1, rough=half).rotation, np.diag([-1, -1, 1]), atol=1e-9)
    registration = register(LAYOUT + 3.0, LAYOUT, 0.1)
    assert scan_frame(registration).to_local(LAYOUT) == pytest.approx(LAYOUT + 3.0)
