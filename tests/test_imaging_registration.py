"""Laws of marker registration: known poses, invariances, closed forms of the target error."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refusal
from scipy.spatial.transform import Rotation

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.registration import pairing
from needlefit.imaging.registration.register import check_axis_signs, register, scan_frame

seeds = st.integers(0, 2**32 - 1)

LAYOUT = np.array(
    [[5, -40, -31], [22, 40, -18], [41, -40, 24], [58, 21, 40], [76, 40, 27], [80, -33, -38]], dtype=float
)
SQUARE = np.array([[20, 20, 0], [-20, 20, 0], [-20, -20, 0], [20, -20, 0]], dtype=float)


def pose_of(rng):
    return Frame(rng.normal(size=3) * 100, Rotation.random(rng=rng).as_matrix())


# known poses


@settings(max_examples=30)
@given(seeds)
def test_exact_markers_in_any_order_give_the_pose_exactly(seed):
    rng = np.random.default_rng(seed)
    pose, order = pose_of(rng), rng.permutation(6)
    registration = register(pose.to_local(LAYOUT)[order], LAYOUT, 0.1)
    assert registration.pairs[:, 1].tolist() == order.tolist()
    np.testing.assert_allclose(
        scan_frame(registration).to_world(pose.to_local(3 * SQUARE)), 3 * SQUARE, atol=1e-9
    )
    turn = registration.rotation
    assert abs(np.linalg.det(turn) - 1) < 1e-12 and np.allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert registration.fre < 1e-9
    assert registration.warnings == ()


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


# predicted errors


def root_mean_square(alignment, point):
    (moved,) = pairing.motion_jacobian([point - alignment.centre])
    return np.sqrt(np.trace(moved @ alignment.covariance @ moved.T))


def test_the_error_of_a_square_is_the_closed_form():
    """Half-side a: f_1^2 = f_2^2 = a^2, f_3^2 = 2 a^2; at height h over the centre d_1 = d_2 = h, d_3 = 0.

    TRE^2 = 3 sigma^2 / 4 (1 + 2 h^2 / (3 a^2)).
    """
    sigma, a = 0.2, 20.0
    sets = pairing.make_marker_sets(SQUARE, SQUARE, sigma, 0.0)
    alignment = pairing.align_pairs(sets, np.array([[n, n] for n in range(4)]))
    for height in (0.0, 20.0, 75.0):
        expected = np.sqrt(3 * sigma**2 / 4 * (1 + 2 * height**2 / (3 * a**2)))
        assert root_mean_square(alignment, [0, 0, height]) == pytest.approx(expected)
    # in the plane, at distance d along x: d_1 = 0, d_2 = d_3 = d
    d = 60.0
    expected = np.sqrt(3 * sigma**2 / 4 * (1 + (d**2 / a**2 + d**2 / (2 * a**2)) / 3))
    assert root_mean_square(alignment, [d, 0, 0]) == pytest.approx(expected)


# ---- what is refused: every fault is named and can be fixed


POSE = Frame(np.array([12.0, -85.0, 140.0]), Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())
FOUND = POSE.to_local(LAYOUT)


def refused(*arguments, **keywords):
    error = refusal(DataError, "", register, *arguments, **keywords)
    assert error.where and error.expected and error.fix
    return str(error)


@pytest.mark.parametrize(
    ("found", "known", "sd", "word"),
    [
        (LAYOUT[:2], LAYOUT, 0.1, "2 markers"),
        (LAYOUT, LAYOUT[:2], 0.1, "known markers: 2 markers"),
        (LAYOUT, LAYOUT[:2], 0.1, "every marker"),
        ([], LAYOUT, 0.1, "0 markers"),
        (LAYOUT, LAYOUT, 0.0, "zero"),
    ],
)
def test_markers_that_cannot_be_registered_are_refused(found, known, sd, word):
    assert word in refused(found, known, sd)


def test_markers_on_a_line_are_refused_exactly_and_within_noise():
    line = np.outer(np.arange(4.0), [10.0, 20.0, 5.0])
    assert "line" in refused(line, line, 0.1)
    # 0.5 mm beside a line, known to 0.1 mm: the turn about it to 14 degrees
    bent = np.array([[0, 0, 0], [35, 0, 0], [80, 0.5, 0]], dtype=float)
    assert "degrees" in refused(bent, bent, 0.1)
    assert register(bent * [1, 40, 1], bent * [1, 40, 1], 0.1).fre < 1e-9
    text = refused(FOUND, LAYOUT, 50.0)
    assert "50 mm" in text and "reference_sd_mm" in text
    layout = np.array([[0, 0, 0], [30, 0, 0], [75, 0, 0], [10, 40, 25]], dtype=float)
    assert "lie on a line" in refused(layout[:3], layout, 0.1)


def test_mirrored_and_flat_markers_are_reported_and_ras_read_as_lps_is_a_turn():
    for axis in [0, 1, 2]:
        signs = np.ones(3)
        signs[axis] = -1
        assert "mirrored" in refused(FOUND * signs, LAYOUT, 0.1)
    flat = LAYOUT * [1, 1, 0]
    registration = register(flat * [1, -1, 1], flat, 0.1)
    assert np.linalg.det(registration.rotation) == pytest.approx(1)
    assert any("mirrored scan" in remark for remark in registration.warnings)
    flipped = FOUND * [-1, -1, 1]
    assert register(flipped, LAYOUT, 0.1).fre < 1e-9


def test_fiducials_of_a_file_are_compared_with_what_the_volume_shows():
    check_axis_signs(FOUND[:4], FOUND, 0.5)
    check_axis_signs(FOUND + 37, FOUND, 0.5)  # of other things
    refusal(DataError, r"RAS.* LPS", lambda: check_axis_signs(FOUND[:4] * [-1, -1, 1], FOUND + 0.2, 0.5))


def test_a_wrong_spacing_or_unit_is_refused():
    for factors in [(1.02, 1.02, 1.02), (0.5, 0.5, 0.5), (1.0, 1.0, 0.46), (1.1, 1.1, 1.0)]:
        assert "spacing" in refused(FOUND * factors, LAYOUT, 0.1)
    for mm in [10, 25.4, 0.001]:
        assert "no pairing" in refused(FOUND, LAYOUT / mm, 0.1)
    assert register(FOUND * 1.004, LAYOUT, 0.1).p_value < 0.1


def test_unrelated_markers_three_of_many_and_understated_noise_are_refused():
    rng = np.random.default_rng(8)
    others = rng.uniform(-40, 40, (7, 3))
    assert "no pairing" in refused(others, LAYOUT, 0.1)
    assert "no pairing" in refused(np.concatenate([FOUND[:3], others[:2]]), LAYOUT[[0, 1, 2, 4]], 0.1)
    rng = np.random.default_rng(9)
    found = FOUND + 0.3 * rng.normal(size=(6, 3))
    assert "no pairing" in refused(found, LAYOUT, 0.03)
