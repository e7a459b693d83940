"""Laws of marker registration: known poses, invariances, closed forms of the target error."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pytest import approx
from refusals import refusal
from scipy.spatial.transform import Rotation

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.registration import register, target_covariance

LAYOUT = np.array(
    [[5, -40, -31], [22, 40, -18], [41, -40, 24], [58, 21, 40], [76, 40, 27], [80, -33, -38]], dtype=float
)


def pose_of(rng):
    return Frame(rng.normal(size=3) * 100, Rotation.random(rng=rng).as_matrix())


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_exact_markers_in_any_order_give_the_pose_exactly(seed):
    rng = np.random.default_rng(seed)
    pose, order = pose_of(rng), rng.permutation(6)
    registration = register(pose.to_local(LAYOUT)[order], LAYOUT, 0.1)
    assert registration.pairs[:, 1].tolist() == order.tolist()
    assert registration.frame.rotation == approx(pose.rotation, abs=1e-11)
    assert registration.frame.origin == approx(pose.origin, abs=1e-9)
    assert registration.fre < 1e-9
    assert registration.warnings == ()


def test_missing_spurious_and_moved_markers_are_left_out_and_named():
    rng = np.random.default_rng(3)
    pose = pose_of(rng)
    found = pose.to_local(np.concatenate([LAYOUT[:5], [[10, 10, 10]]])) + 0.05 * rng.normal(size=(6, 3))
    registration = register(found, LAYOUT, 0.05)
    assert registration.pairs.tolist() == [[n, n] for n in range(5)]
    assert "5" in registration.warnings[0] and "5" in registration.warnings[1]
    moved = LAYOUT + np.eye(6)[:, 3:4] * [0, 0, 2.0]
    assert 3 not in register(moved, LAYOUT, 0.05).pairs[:, 0]


def test_the_error_of_a_target_is_the_closed_form():
    """Fitzpatrick 1998: TRE^2 = 3 sigma^2 / N (1 + sum d_k^2 / f_k^2 / 3); d, f: from principal axes."""
    sigma, target = 0.2, np.array([75.0, 4.0, -30.0])
    registration = register(LAYOUT, LAYOUT, sigma)
    middle = LAYOUT.mean(axis=0)
    axes = np.linalg.svd(LAYOUT - middle)[2]
    squares = ((np.vstack([LAYOUT, target]) - middle) @ axes.T) ** 2
    from_axes = squares.sum(axis=1, keepdims=True) - squares
    ratio = from_axes[-1] / from_axes[:-1].mean(axis=0)
    expected = 3 * sigma**2 / len(LAYOUT) * (1 + ratio.sum() / 3)
    (covariance,) = target_covariance(registration, [target])
    assert np.trace(covariance) == approx(expected)
    assert registration.expected_fre == approx(sigma * np.sqrt(3 - 6 / len(LAYOUT)))


POSE = Frame(np.array([12.0, -85.0, 140.0]), Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())
FOUND = POSE.to_local(LAYOUT)
RNG = np.random.default_rng(8)
OTHERS = RNG.uniform(-40, 40, (7, 3))
NOISE = RNG.normal(size=(6, 3))
LINE = np.outer(np.arange(4.0), [10.0, 20.0, 5.0])
# 0.5 mm beside a line, known to 0.1 mm: the turn about it to 14 degrees
BENT = np.array([[0, 0, 0], [35, 0, 0], [80, 0.5, 0]], dtype=float)
SQUARE = np.array([[20, 20, 0], [-20, 20, 0], [-20, -20, 0], [20, -20, 0]], dtype=float)


@pytest.mark.parametrize(
    ("found", "known", "sd", "words"),
    [
        (LINE, LINE, 0.1, "line"),
        (BENT, BENT, 0.1, "line"),
        (BENT, [*BENT, [10, 40, 25]], 0.1, "line"),
        (SQUARE, SQUARE, 0.1, "two pairings"),
        (FOUND, LAYOUT, 50.0, "50 mm"),
        (FOUND * [1, -1, 1], LAYOUT, 0.1, "mirrored"),
        (FOUND * 1.02, LAYOUT, 0.1, "spacing"),
        (FOUND * [1, 1, 0.46], LAYOUT, 0.1, "spacing"),
        (OTHERS, LAYOUT, 0.1, "no pairing"),
        (OTHERS[:0], LAYOUT, 0.1, "three or more"),
        (OTHERS[:2], LAYOUT, 0.1, "three or more"),
        ([*FOUND[:3], *OTHERS[:2]], LAYOUT[[0, 1, 2, 4]], 0.1, "no pairing"),  # three of many
        (FOUND + 0.3 * NOISE, LAYOUT, 0.03, "no pairing"),  # understated noise
    ],
)
def test_markers_that_do_not_give_the_pose_are_refused(found, known, sd, words):
    error = refusal(DataError, words, register, found, known, sd)
    assert error.where and error.expected and error.fix


def test_markers_just_beside_a_line_and_a_spacing_within_the_noise_are_registered():
    assert register(BENT * [1, 40, 1], BENT * [1, 40, 1], 0.1).fre < 1e-9
    assert register(FOUND * 1.004, LAYOUT, 0.1).p_value < 0.1
