"""Derivatives of many sets at once are those of single ones, to the bit, and those of complex steps."""

from dataclasses import replace

import numpy as np
import pytest
from mechanics_cases import NEEDLE, assert_derivatives, assert_same_bits, random_batch

from needlefit.errors import ModelError
from needlefit.mechanics.batch import (
    DERIVATIVE_KINDS,
    Batch,
    Jacobians,
    compute_batch_positions,
    differentiate_batch_positions,
    differentiate_positions,
    linearize_batches,
    linearize_steps,
    simulate_batches,
)
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.native import compute_positions as compute_position_blocks
from needlefit.mechanics.packing import PreparedInsertion
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.tissue import Tissue

RUBBING = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[5.3], friction=[0.2, 0.1])
GUIDED = Controls(0.2, 0.004, 0.002, (Guide(-9.0, 0.1, None), Guide(3.7, 0.05, in_tissue=True)))
STEPS = (Step(6.0, Bevel(0.1), GUIDED), Step(11.4, Bevel(0.05, -1), GUIDED))


def linearize(batch: Batch, wrt=DERIVATIVE_KINDS, threads: int | None = None):
    ((shapes, jacobians),) = linearize_batches([batch], wrt, threads)
    return shapes, jacobians


def make_batch(sets: int, steps: tuple[Step, ...] = STEPS, tissue: Tissue = RUBBING, **more) -> Batch:
    rng = np.random.default_rng(3)
    mu, alpha = 10 ** rng.uniform(-1.0, 1.5, (sets, 2)), rng.uniform(-6, 6, (sets, 2))
    return Batch(NEEDLE, tissue, steps, mu=mu, shape=alpha[:, None], offset=rng.uniform(0, 0.2, sets), **more)


@pytest.mark.parametrize("seed", range(40))
def test_every_set_is_what_a_single_one_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    batch = random_batch(rng, int(rng.integers(1, 12)), within=True, friction=float(rng.integers(0, 2)))
    shapes, jacobians = linearize(batch)
    s = np.linspace(shapes.x[0, 0] + 1.0, shapes.x[0, -1], 9)
    s = s[s >= shapes.x[:, 0].max()]
    points, moves = compute_batch_positions(shapes, s), differentiate_batch_positions(shapes, jacobians, s)
    for i in range(len(batch)):
        shape, jacobian = linearize_steps(*batch.pick(i), wrt=DERIVATIVE_KINDS)
        assert_same_bits(shapes[i], shape)
        assert_same_bits(jacobians[i], jacobian)
        if shape.converged:
            np.testing.assert_array_equal(points[i], compute_positions(shape, s))
            np.testing.assert_array_equal(moves[i], differentiate_positions(shape, jacobian, s))


@pytest.mark.parametrize("advance", ["tangent", "path_angle"])
def test_derivatives_in_lanes_are_those_of_complex_steps(advance: str) -> None:
    """By every kind of parameter, with friction, guides before and in the tissue, a turn of the bevel."""
    batch = make_batch(9)
    if advance == "path_angle":
        steps = tuple(replace(s, bevel=Bevel(0.0, s.bevel.side, 0.01)) for s in STEPS)
        angles = np.linspace(0.0, 0.03, 9)
        batch = replace(
            batch, steps=steps, rules=ModelOptions(advance=advance), offset=None, cut_angle=angles
        )
    shapes, jacobians = linearize(batch)
    assert shapes.converged.all() and len(jacobians.names) == 19
    for i in (0, 7, 8):
        assert_derivatives(jacobians[i], *batch.pick(i), rtol=1e-6)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_neighbours_and_threads_change_no_bit(threads: int) -> None:
    batch, some = make_batch(21), slice(3, 6)
    part = batch.with_sets(mu=batch.mu[some], shape=batch.shape[some], offset=batch.offset[some])
    pairs = linearize_batches([batch, part, make_batch(1)], ("mu", "guides", "offset"), threads)
    (whole, by), (shapes, by_part), (alone, by_alone) = pairs
    for i in range(3):
        assert_same_bits(shapes[i], whole[3 + i])
        assert_same_bits(by_part[i], by[3 + i])
    assert_same_bits(by_alone[0], linearize(make_batch(1), ("mu", "guides", "offset"), 1)[1][0])
    assert_same_bits(alone[0], make_alone())


def make_alone() -> NeedleShape:
    return linearize_steps(*make_batch(1).pick(0), wrt=("mu",))[0]


def test_a_guide_that_stands_elsewhere_in_each_set() -> None:
    steps = (Step(12.0, Bevel(0.1), Controls(guides=(Guide(-9.0, 0.1),))),)
    places = np.array([-3.0, -20.0, np.nan, -9.0, 5.0])
    batch = make_batch(5, steps, guide_x=places)
    shapes, jacobians = linearize(batch, ("guides", "mu"))
    assert shapes.converged.tolist() == [True, True, False, True, False]
    for i in (0, 1, 3):
        shape, jacobian = linearize_steps(*batch.pick(i), wrt=("guides", "mu"))
        assert_same_bits(shapes[i], shape)
        assert_same_bits(jacobians[i], jacobian)
    for part in (jacobians[2].x, jacobians.u[4], jacobians.constraints[2], jacobians.tip_track[4]):
        assert np.isnan(part).all()


def test_what_is_prepared_serves_other_sets() -> None:
    """A batch whose sets are all invalid prepares the insertion as well as any other."""
    first = make_batch(2).with_sets(mu=np.full((2, 2), np.nan), shape=np.ones((2, 1, 2)), offset=np.zeros(2))
    assert not simulate_batches([first])[0].converged.any()
    other = make_batch(3)
    shared = first.with_sets(mu=other.mu, shape=other.shape, offset=other.offset)
    assert shared.prepared is first.prepared and len(shared.prepared) == 1
    for one, expected in zip(linearize(shared), linearize(other), strict=True):
        assert isinstance(one, Jacobians) or one.converged.all()
        for i in range(3):
            assert_same_bits(one[i], expected[i])
    with pytest.raises(ModelError, match="mu"):
        first.with_sets(mu=other.mu)


def test_sets_that_the_prepared_problem_cannot_take_are_type_errors() -> None:
    insertion = PreparedInsertion(NEEDLE, RUBBING, STEPS, ModelOptions())
    problem = insertion.pack(2, {})
    arrays = {
        name: problem.arrays[name]
        for name in ("rigidity", "mu", "thickness", "friction", "law", "turn", "base")
    }
    assert problem.with_sets(2, arrays).sets == 2
    for wrong in (
        {name: arrays[name] for name in arrays if name != "mu"},
        arrays | {"guide_x": np.zeros(2)},
        arrays | {"mu": arrays["mu"][:1]},
        arrays | {"turn": arrays["turn"][:, :1]},
        arrays | {"base": arrays["base"].astype(np.float32)},
    ):
        with pytest.raises(TypeError):
            problem.with_sets(2, wrong)
    with pytest.raises(TypeError):
        problem.with_sets(3, arrays)


def make_needles(count):
    rng = np.random.default_rng(5)
    x = np.tile(np.concatenate([[-90.0, -40.0], np.linspace(0.0, 20.0, 21)]), (count, 1))
    u, slope = (np.cumsum(part * rng.normal(size=x.shape), axis=1) for part in (0.02, 0.002))
    return x, u, slope, np.sort(rng.uniform(-60.0, 20.0, 30))


def compare(x, u, slope, s):
    single = [
        compute_position_blocks(*(part[i : i + 1] for part in (x, u, slope)), s)[0] for i in range(len(x))
    ]
    assert np.array_equal(compute_position_blocks(x, u, slope, s), single, equal_nan=True)


def test_points_of_a_block_of_needles_that_bend_far_failed_or_have_other_nodes():
    for count in (1, 32, 45):
        compare(*make_needles(count))
    x, u, slope, s = make_needles(40)
    slope[3] = 1.5
    u[35], slope[35] = np.nan, np.nan
    compare(x, u, slope, s)
    x, u, slope, s = make_needles(40)
    x[2, 1] = -30.0
    compare(x, u, slope, s)
