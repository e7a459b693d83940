"""What one more insertion tells, against the closed form of data linear in Gaussian parameters."""

import numpy as np
import pytest
from inference_cases import insertion

from needlefit.inference.identifiability.design_gain import PredictedData, linearized_gain, nested_gain
from needlefit.inference.likelihood.nodes import ErrorAxis, Nodes, make_group, make_nodes

COVARIANCE = np.array([[1.0, -0.6], [-0.6, 0.5]])
SLOPES = np.array([[1.5, 0.4], [0.2, 1.1], [-0.7, 0.9]])  # (R, P), whitened


def predict_data(thetas: np.ndarray, by_depth: np.ndarray) -> PredictedData:
    """Draws of equal weight whose data are SLOPES theta; one uncertain depth moves them by `by_depth`."""
    first = thetas @ SLOPES.T
    white = np.stack([first, first + by_depth, first - by_depth], axis=1)  # (B, m, R)
    turns = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, -0.5]])
    one = insertion(30.0)
    nodes = Nodes(
        (one,) * 3, np.empty((3, 0)), (ErrorAxis(),), turns, np.zeros((0, 3)), bevel=False, rule=None
    )
    count = len(thetas)
    logs = np.full(count, -np.log(count))
    return PredictedData(logs, np.ones(count), np.zeros(count), white, make_group(nodes))


@pytest.mark.parametrize("by_depth", [np.zeros(3), np.array([0.5, -1.0, 2.0])])
def test_nested_gain_and_deviations_are_those_of_the_linear_gaussian_case(by_depth):
    rng = np.random.default_rng(1)
    thetas = rng.multivariate_normal([0.0, 0.0], COVARIANCE, size=1200)
    found = nested_gain(predict_data(thetas, by_depth), np.arange(400), thetas, rng)
    noise = np.eye(3) + np.outer(by_depth, by_depth)  # the depth, integrated over
    after = np.linalg.inv(np.linalg.inv(COVARIANCE) + SLOPES.T @ np.linalg.solve(noise, SLOPES))
    nats = 0.5 * np.log(np.linalg.det(COVARIANCE) / np.linalg.det(after))
    assert found.nats == pytest.approx(nats, abs=3.5 * found.nats_se)
    assert found.nats_se < 0.06
    assert found.sds == pytest.approx(np.sqrt(np.diag(after)), rel=0.05)
    fall = 0.5 * np.log(np.diag(COVARIANCE) / np.diag(after))
    assert found.quantity_nats == pytest.approx(fall, abs=0.05)


def test_linear_gain_is_half_the_log_determinant():
    after = np.linalg.inv(np.linalg.inv(COVARIANCE) + SLOPES.T @ SLOPES)
    nats = 0.5 * np.log(np.linalg.det(COVARIANCE) / np.linalg.det(after))
    assert linearized_gain(COVARIANCE, SLOPES) == pytest.approx(nats, rel=1e-9)


def test_weights_count_as_draws():
    """A draw of double weight is two draws."""
    rng = np.random.default_rng(2)
    thetas = rng.multivariate_normal([0.0, 0.0], COVARIANCE, size=50)
    twice = np.concatenate([thetas, thetas[:10]])
    heavy = predict_data(thetas, np.zeros(3))
    weights = np.log(np.where(np.arange(50) < 10, 2.0, 1.0) / 60)
    heavy = PredictedData(weights, heavy.scales, heavy.spreads, heavy.white, heavy.group)
    of = np.arange(20)
    one = nested_gain(heavy, of, thetas, np.random.default_rng(3))
    other = nested_gain(predict_data(twice, np.zeros(3)), of, twice, np.random.default_rng(3))
    assert one.nats == pytest.approx(other.nats, rel=1e-12)
    assert one.sds == pytest.approx(other.sds, rel=1e-9)


def test_uninformative_data_have_zero_gain():
    rng = np.random.default_rng(4)
    thetas = rng.standard_normal((100, 1))
    group = make_group(make_nodes(insertion(30.0), np.empty(0), "fixed"))
    logs = np.full(100, -np.log(100.0))
    blind = PredictedData(logs, np.ones(100), np.zeros(100), np.zeros((100, 1, 5)), group)
    found = nested_gain(blind, np.arange(30), thetas, rng)
    assert found.nats == pytest.approx(0.0, abs=1e-12)
    assert found.quantity_nats == pytest.approx([0.0], abs=1e-12)
    assert found.effective_sample_size == pytest.approx(100.0)
