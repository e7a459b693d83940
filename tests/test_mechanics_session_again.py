"""A session's copies, the shortest way to where it stands, and the same way through another tissue."""

from dataclasses import replace

import numpy as np
import pytest
from mechanics_cases import NEEDLE, random_needle, random_rules, random_steps, random_tissue

from needlefit.mechanics.control import Bevel, Controls, Guide, Step, TrackedTip
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue

SOFT, STIFF = (Tissue(mu=[mu, 5.0], alpha=[1.0, -1.0], boundaries=[12.3]) for mu in (0.2, 2.0))
LEFT, RIGHT = Bevel(0.08, 1), Bevel(0.08, -1)


def assert_near(found: NeedleShape, expected: NeedleShape) -> None:
    for name in ("x", "u", "slope", "constraints"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-6, err_msg=name)


def wandered(seed: int) -> tuple[Session, np.random.Generator]:
    """Return a session after random steps, in and out, and the generator that goes on."""
    rng = np.random.default_rng(seed)
    rules = random_rules(rng)
    needle, tissue = random_needle(rng, rules), random_tissue(rng, rules)
    steps = random_steps(rng, 6)
    under_way = Session(needle, tissue, steps[0].bevel, rng.uniform(0.05, 1) * rules.spacing, rules=rules)
    for step in steps:
        under_way.go(step)
    return under_way, rng


@pytest.mark.parametrize("seed", range(20))
def test_a_copy_continues_independently_of_the_original(seed: int) -> None:
    first, rng = wandered(seed)
    second, before = first.copy(), first.now.shape
    steps = random_steps(rng, 3)
    there = [second.go(step) for step in steps]
    assert first.now.shape is before
    for step, expected in zip(steps, there, strict=True):
        np.testing.assert_array_equal(first.go(step).u, expected.u)


@pytest.mark.parametrize("seed", range(40))
def test_the_path_reproduces_the_needle_and_can_be_continued(seed: int) -> None:
    under_way, rng = wandered(seed)
    input_path = under_way.input_path()
    again = simulate_steps(under_way.needle, under_way.tissue, input_path, under_way.rules, under_way.lattice)
    assert_near(again, under_way.now.shape)
    retold, start = under_way.simulate_again(), input_path[0]
    single = Session(
        under_way.needle, under_way.tissue, start.bevel, under_way.lattice.first_cell, start.controls,
        under_way.rules,
    )  # fmt: skip
    for step in input_path:
        single.go(step)
    np.testing.assert_array_equal(retold.now.shape.u, single.now.shape.u)
    assert retold.solved == single.solved
    for step in random_steps(rng, 2):
        assert_near(retold.go(step), under_way.go(step))


def test_the_path_omits_what_was_undone() -> None:
    under_way = Session(NEEDLE, SOFT, LEFT)
    under_way.step(insert=20)
    for _ in range(50):
        under_way.step(insert=10, bevel=RIGHT, base=(0.5, 0.0))
        under_way.step(insert=-10, bevel=LEFT, base=(0.0, 0.0))
    assert under_way.input_path() == (Step(20.0, LEFT),)


def test_inputs_changed_and_changed_back_within_a_cell_cut_anew() -> None:
    """The ray is anchored again at the tip, though the course has the same inputs on both sides."""
    under_way = Session(NEEDLE, SOFT, LEFT, 0.7)
    under_way.step(insert=10.2)
    under_way.step(bevel=RIGHT)
    under_way.step(insert=5.3, bevel=LEFT)
    again = simulate_steps(NEEDLE, SOFT, under_way.input_path(), lattice=Lattice(0.7, 1.0))
    straight = simulate_steps(NEEDLE, SOFT, (Step(15.5, LEFT),), lattice=Lattice(0.7, 1.0))
    assert_near(again, under_way.now.shape)
    assert abs(straight.tip_lateral - again.tip_lateral) > 1e-4


def test_inputs_changed_and_changed_back_at_the_tip_cut_anew_from_there() -> None:
    under_way = Session(NEEDLE, SOFT, LEFT, 0.7)
    under_way.step(insert=10.2)
    under_way.step(bevel=RIGHT)
    under_way.step(bevel=LEFT)
    retold, untouched = under_way.simulate_again(), Session(NEEDLE, SOFT, LEFT, 0.7)
    untouched.step(insert=10.2)
    assert_near(retold.step(insert=5.3), under_way.step(insert=5.3))
    assert abs(untouched.step(insert=5.3).tip_lateral - under_way.now.shape.tip_lateral) > 1e-4


def test_a_path_is_simulated_in_another_tissue() -> None:
    guided = Controls(guides=(Guide(-20.0),))
    steps = (Step(10.0, LEFT), Step(18.4, RIGHT, guided), Step(25.0, LEFT, guided))
    under_way = Session(NEEDLE, SOFT, LEFT)
    for step in steps:
        under_way.go(step)
    under_way.step(insert=5)
    under_way.step(insert=-5)
    expected = simulate_steps(NEEDLE, STIFF, steps, lattice=Lattice(1.0, 1.0))
    assert_near(under_way.simulate_again(STIFF).now.shape, expected)
    blunt = tuple(replace(step, bevel=replace(step.bevel, offset=0.01)) for step in steps)
    retold = under_way.simulate_again(offset=0.01)
    assert_near(retold.now.shape, simulate_steps(NEEDLE, SOFT, blunt, lattice=Lattice(1.0, 1.0)))
    assert retold.last == blunt[-1]


def test_a_failed_path_is_located_and_the_original_is_unchanged() -> None:
    thin = Tissue(mu=[0.5], alpha=[8.0], thickness=[1.0])
    under_way = Session(NEEDLE, replace(thin, thickness=[60.0]), LEFT)
    under_way.step(insert=5.4)
    before = under_way.step(tip=TrackedTip(-3.0))
    retold = under_way.simulate_again(thin)
    assert before.converged and retold.failures
    assert under_way.now.shape is before and retold.depth == 5.4
