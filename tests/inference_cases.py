"""Insertions for the tests of inference: simulated with the model itself, so their truth is known."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from problem_cases import make_problem as build_problem
from pytest import approx

from needlefit import Needle
from needlefit.datasets.insertion import Dataset, Insertion, Noise
from needlefit.geometry.frames import Frame
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.stated_errors import PLAIN_LIKELIHOOD
from needlefit.inference.metric_objective import WeightedDistances
from needlefit.inference.parameter_names import is_shape_parameter
from needlefit.inference.parameters import Parameters
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord

NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)
NOISE = Noise(registration_mean=0.19, point_sd=0.05, correlated_sd=0.1, correlation_length=5.0)
TRUTH = {"mu1_pa": 3e5, "alpha1": 1.0, "mu2_pa": 2e7, "alpha2": -1.0, "bevel_mm": 0.08}
MU, BEVEL = [1e3, 1e9], [1e-3, 0.5]


def medium(layers=2, **changed):
    """Two layers, mu and b free, alpha fixed at the truth; `changed` replaces single parameters."""
    free = {f"mu{k}_pa": {"bounds": MU} for k in range(1, layers + 1)}
    fixed = {f"alpha{k}": {"fixed": TRUTH.get(f"alpha{k}", 1.0)} for k in range(1, layers + 1)}
    table = {**free, **fixed, "bevel_mm": {"bounds": BEVEL}, **changed}
    return MediumRecord.model_validate({"schema": 1, "title": "test", "layers": layers, "parameters": table})


def insertion(
    depth,
    boundaries=(),
    sequence=(1,),
    side=1,
    angle_sd=0.004,
):
    """Conditions of an insertion not yet measured."""
    return Insertion(
        id=f"at{depth:g}", medium="test", specimen=f"at{depth:g}", needle=NEEDLE, layers=len(sequence),
        layers_alternative=len(sequence), depth=depth, side=side, frame=Frame(np.zeros(3), np.eye(3)),
        pose_source="stage", pose_shift_sd=0.0, pose_angle_sd=angle_sd, centerline=np.zeros((2, 3)),
        points=np.zeros((2, 3)), boundaries=np.array(boundaries, dtype=float),
        sequence=tuple(sequence), boundary_sd=0.0,
    )  # fmt: skip


def measure(
    values,
    record,
    planned,
    points=101,
    error=None,
):
    """The insertion with the model's own shape as its measured centreline."""
    planar = sample_inserted_points(predict(values, record, planned), points)[:, :2]
    return planned.with_points(planar if error is None else error(planar))


def from_first_point(one):
    """The insertion as it is known where its entry is its first point, which has moved with the needle."""
    moved = one.with_points(one.points - [0.0, *one.points[0, 1:]])
    return replace(moved, pose_source="first_point")


def dataset(insertions, noise=NOISE, pose="known", drop=0.0):
    return Dataset(
        "cases", "cases", "synthetic", tuple(insertions), ("test",), noise, pose, drop, Path(), "0"
    )  # fmt: skip


def two_layers(record=None, count=3, **options):
    """A problem whose objective is 0 at TRUTH, but for rounding."""
    record = medium() if record is None else record
    made = [
        measure(TRUTH, record, insertion(30.0 + 4.3 * k, (12.0 + 3 * k,), (1, 2), (1, -1)[k % 2]), **options)
        for k in range(count)
    ]
    return problem(record, made)


def problem(record, made, how=None, **options):
    how = PLAIN_LIKELIHOOD if how is None else how
    return build_problem(dataset(made, **options), made, record, how)


def recipe(**changed):
    return RecipeRecord.model_validate(
        {"schema": 1, "minimize": "metric", "starts": 4, "evaluations": 200} | changed
    )


def squares_recipe(**changed):
    """The same budget, spent on the posterior."""
    return recipe(**{"minimize": "posterior", **changed})


def assert_one_density(p, theta, rtol=1e-5, shape_step=3.0):
    """Values, residuals and their Jacobian are of one density, and exact.

    Differences are of fourth order; of shape parameters, on which needles hardly depend, over `shape_step`.
    """
    residuals, exact = p.jacobian(theta)
    gradient = -(residuals @ exact)
    assert p.log_posteriors(theta[None])[0] == approx(p.log_posterior(theta), rel=1e-6)
    for along in np.eye(len(theta)):
        ends = [p.log_posterior(theta + h * along) for h in (-2e-3, -1e-3, 1e-3, 2e-3)]
        slope = (8 * (ends[2] - ends[1]) - (ends[3] - ends[0])) / 12e-3
        assert gradient @ along == approx(slope, rel=rtol, abs=rtol * np.linalg.norm(gradient))
    constants = [p.log_posterior(t) + 0.5 * np.sum(p.jacobian(t)[0] ** 2) for t in (theta, theta - 0.1)]
    assert constants[0] == approx(constants[1], rel=1e-9, abs=1e-6)
    shape = np.array([is_shape_parameter(name) for name in p.names])
    steps = np.where(shape, shape_step, 2e-3)

    def differ(move):
        return (p.jacobian(theta + move)[0] - p.jacobian(theta - move)[0]) / 2

    moves = np.diag(steps)
    fourth = np.stack([(8 * differ(m / 2) - differ(m)) / 3 / m.max() for m in moves], axis=1)
    off = np.linalg.norm(exact - fourth, axis=0) / np.linalg.norm(fourth, axis=0)
    assert np.all(off < np.where(shape, max(1e-3, rtol), rtol)), dict(zip(p.names, off, strict=True))


def assert_objective_slope(p, theta, step=1e-5, rtol=1e-5, atol=1e-6):
    """The objective's gradient is that of central differences."""
    value, slope = p.objective_gradient(theta)
    assert value == approx(p.objective(theta), rel=1e-8)
    ends = [(p.objective(theta + m) - p.objective(theta - m)) / 2 / step for m in step * np.eye(len(theta))]
    assert slope == approx(ends, rel=rtol, abs=atol)


class NothingHeld:
    """What stands for a problem of which no parameter is held at the centre of its prior."""

    parameters = Parameters((), {}, {}, {})

    @property
    def searched(self):
        return self


@dataclass(frozen=True)
class Analytic(NothingHeld):
    """A function on a box, in the form that `minimize` and `sample` ask for; its slope by differences."""

    function: Callable[[np.ndarray], float]
    lower: np.ndarray
    upper: np.ndarray

    @property
    def names(self):
        return tuple(f"x{k}" for k in range(len(self.lower)))

    def objective(self, theta):
        return self.function(theta)

    def objective_gradient(self, theta):
        moves = 1e-6 * np.eye(len(theta))
        slopes = [(self.function(theta + m) - self.function(theta - m)) / 2e-6 for m in moves]
        return self.function(theta), np.array(slopes)

    def distances(self, theta):
        value, slope = self.objective_gradient(theta)
        return WeightedDistances(np.ones(1), np.array([[value, 0.0]]), np.array([[slope, 0.0 * slope]]))

    def values(self, theta):
        return {name: float(x) for name, x in zip(self.names, theta, strict=True)}


@dataclass(frozen=True)
class Squares(NothingHeld):
    """Residuals with their Jacobian on a box, as a posterior: a constant minus half their squares."""

    slopes: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    lower: np.ndarray
    upper: np.ndarray
    constant: float = 7.0
    plain: "Squares | None" = None

    def compute_misfits(self, theta):
        return self.residuals(theta)

    def residuals(self, theta):
        return self.slopes(theta)[0]

    def jacobian(self, theta):
        return self.slopes(theta)

    def log_posterior(self, theta):
        inside = np.all((theta >= self.lower) & (theta <= self.upper))
        return self.constant - 0.5 * float(np.sum(self.residuals(theta) ** 2)) if inside else -np.inf

    def values(self, theta):
        return {f"x{k}": float(x) for k, x in enumerate(theta)}


def box(function, dimensions=2, half=2.0):
    return Analytic(function, np.full(dimensions, -half), np.full(dimensions, half))
