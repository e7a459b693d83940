"""A session is the same insertion, step by step: identity, sub-steps, retraction, failures."""

from collections import Counter
from functools import partial

import numpy as np
import pytest
from mechanics_cases import (
    NEEDLE,
    assert_same_bits,
    list_seeds,
    random_case,
    random_needle,
    random_rules,
    random_steps,
    random_tissue,
)
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from space_cases import random_spatial_case

from needlefit import Bevel, Guide, Session, Tissue, TrackedTip, simulate_steps

TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
LEFT, RIGHT = Bevel(0.1, 1), Bevel(0.1, -1)
assert_same_steps = partial(assert_same_bits, but=("iterations",))  # each step counts its own


def session(first_cell=1.0, **given):
    return Session(NEEDLE, TISSUE, LEFT, first_cell, **given)


@pytest.mark.parametrize("kind", ["decided", "path_angle"])
@pytest.mark.parametrize("draw", [random_case, random_spatial_case])
@pytest.mark.parametrize("seed", list_seeds(20, 4))
def test_a_session_gives_the_bits_of_the_whole_insertion(seed, draw, kind):
    """After every step: bevels, base, guides, tracked tip and depth change as they like."""
    needle, tissue, steps, rules, lattice = draw(default_rng(seed), kind, deepest=22.0)
    under_way = Session(needle, tissue, steps[0].bevel, lattice.first_cell, steps[0].controls, rules)
    for n, step in enumerate(steps, start=1):
        expected = simulate_steps(needle, tissue, steps[:n], rules, lattice)
        assert_same_steps(under_way.go(step), expected)
        if not expected.converged:
            break  # the session stays where it was


def test_a_long_session_keeps_its_size_and_accuracy():
    """Many steps in and out, each under inputs never seen before."""
    rng = default_rng(0)
    under_way = session(0.4)
    for n in range(1500):
        insert = np.clip(rng.uniform(-2, 2), -under_way.depth, 30 - under_way.depth)
        base, bevel = rng.uniform(-0.3, 0.3, 2) * (1, 0.01), Bevel(rng.uniform(0, 0.1), rng.choice([-1, 1]))
        guides = (Guide(-5.0, rng.uniform(-0.1, 0.1)),) if n % 7 < 2 else ()
        shape = under_way.step(insert, bevel=bevel, base=tuple(base), guides=guides)
        assert shape.converged and np.abs(shape.u).max() < 10
        assert shape.depth == approx(under_way.depth, abs=1e-9)
    remembered = len(under_way._bevels._numbers) + len(under_way._controls._numbers)
    assert remembered < 1500 and len(under_way._memory.list_rays()[0]) < 200
    assert under_way._rays < 1000


# ---- failures and refused inputs change nothing

THIN = Tissue(mu=[0.5], alpha=[8.0], thickness=[2.0])


@pytest.mark.parametrize(
    "step",
    [
        {"insert": 3.3, "base": (0.5, 0.0), "tip": TrackedTip(-3.0)},
        {"insert": -2.1, "tip": TrackedTip(5.0)},
        {"insert": 20.0, "bevel": Bevel(5.0)},
        {"guides": tuple(Guide(-float(n), 9.0 * (n % 2)) for n in range(1, 12))},  # more than ever before
    ],
)
def test_a_failed_step_changes_nothing(step):
    """Each of these compresses tissue of 2 mm to nothing; the needle stays where and as it was."""
    under_way, untouched = Session(NEEDLE, THIN, LEFT, 0.7), Session(NEEDLE, THIN, LEFT, 0.7)
    for one in (under_way, untouched):
        one.step(5.4)
        one.step(-0.9)
    for _ in range(2):
        failed = under_way.step(**step)
        assert failed.status == "over-compressed" and np.isnan(failed.u).all()
        assert failed.depth == approx(4.5 + step.get("insert", 0.0))
        assert under_way.last == untouched.last and under_way.depth == 4.5
    assert under_way.failures == Counter({"over-compressed": 2})
    for after in ({"insert": 0.3}, {"insert": 4.0, "bevel": RIGHT}, {"insert": -2.0}, {"base": (0.1, 0)}):
        assert_same_steps(under_way.step(**after), untouched.step(**after))


# ---- copies, the shortest way to where a session stands, and the same way through another tissue


def assert_near(found, expected):
    for name in ("x", "u", "slope", "constraints"):
        assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-6, err_msg=name)


def wandered(seed):
    """Return a session after random steps, in and out, and the generator that goes on."""
    rng = default_rng(seed)
    rules = random_rules(rng)
    needle, tissue = random_needle(rng, rules), random_tissue(rng, rules)
    steps = random_steps(rng, 6)
    under_way = Session(needle, tissue, steps[0].bevel, rng.uniform(0.05, 1) * rules.spacing, rules=rules)
    for step in steps:
        under_way.go(step)
    return under_way, rng


@pytest.mark.parametrize("seed", list_seeds(20))
def test_a_copy_continues_independently_of_the_original(seed):
    first, rng = wandered(seed)
    second, before = first.copy(), first.now.shape
    steps = random_steps(rng, 3)
    there = [second.go(step) for step in steps]
    assert first.now.shape is before
    for step, expected in zip(steps, there, strict=True):
        assert_array_equal(first.go(step).u, expected.u)


@pytest.mark.parametrize("seed", list_seeds(40, 12))
def test_the_path_reproduces_the_needle_and_can_be_continued(seed):
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
    assert_array_equal(retold.now.shape.u, single.now.shape.u)
    assert retold.solved == single.solved
    for step in random_steps(rng, 2):
        assert_near(retold.go(step), under_way.go(step))
