"""Many parameter sets at once are as many single ones: to rounding, and whatever stands beside them."""

from dataclasses import fields, replace

import numpy as np
import pytest
from mechanics_cases import NEEDLE, assert_close, assert_same_bits, pick, random_steps
from numpy.random import default_rng

from needlefit import Bevel, Controls, Guide, ModelOptions, Step, Tissue, TrackedTip, simulate_steps
from needlefit.mechanics import native
from needlefit.mechanics.batch import Batch, NeedleShapes, simulate_batches

TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
WIDE = Step(14.2, Bevel(0.1), Controls(base_y=0.3))  # its first cell is short: the entry has no node
TURN = Step(17.2, Bevel(0.1, -1), Controls(base_y=0.1, base_slope=0.004))
THERE_AND_BACK = (WIDE, replace(WIDE, depth=5.6), TURN)


HELD = Controls(
    guides=(Guide(-4.0), Guide(5.0, 0.06, None, in_tissue=True), Guide(16.0, 0.1, None, in_tissue=True))
)
RUBBING = replace(TISSUE, friction=[0.3, 0.3])


def one(batch, threads=None):
    (shapes,) = simulate_batches([batch], threads)
    return shapes


def broad(sets, seed=0, steps=THERE_AND_BACK, tissue=TISSUE):
    rng = default_rng(seed)
    mu, alpha = 10 ** rng.uniform(-3, 2, (sets, 2)), rng.uniform(-10, 10, (sets, 2))
    return Batch(NEEDLE, tissue, steps, mu=mu, shape=alpha[:, None], offset=rng.uniform(0, 0.2, sets))


THIN = Tissue(mu=[5.0], alpha=[8.0], thickness=[2.0])
HARD = [  # insertions that were once solved wrongly, or not at all
    # all deflections are prescribed
    *(
        Batch(NEEDLE, THIN, (Step(depth, Bevel(0.1), Controls(
            0.3, 0.01, guides=(Guide(0.0, 0.02, None, in_tissue=True),), tip=TrackedTip(0.05, slope)
        )),), offset=[0.02, 0.1])
        for depth in (0.3, 0.7, 1.0) for slope in (None, 0.02)
    ),
    # guides less than a quarter element before a constraint point take its node
    Batch(NEEDLE, TISSUE, (Step(15.0, Bevel(0.1), Controls(guides=(
        Guide(4.9, 0.02, None, in_tissue=True), Guide(8.06, 0.05, None, in_tissue=True)
    ))),), offset=[0.02, 0.1]),
    # a free guide before a short first element
    Batch(NEEDLE, TISSUE, (Step(9.6, Bevel(0.1), Controls(guides=(
        Guide(-4.0, 0.1, None), Guide(0.3, 0.05, in_tissue=True)
    ))),), mu=[[0.3, 3.0], [2.0, 20.0]]),
    # friction that all but stops the needle
    Batch(NEEDLE, replace(TISSUE, friction=[60.0, 60.0]), (Step(25.0, Bevel(0.2)),), offset=[0.2, 0.02]),
]  # fmt: skip


@pytest.mark.parametrize("batch", HARD)
def test_what_is_hard_to_solve_is_what_newtons_method_gives(batch):
    shapes, exact = one(batch), replace(batch, rules=ModelOptions(tolerance=1e-11))
    for i in range(2):
        assert_close(shapes[i], simulate_steps(*pick(exact, i)))


def part(shapes, sets):
    parts = (getattr(shapes, field.name) for field in fields(shapes))
    return NeedleShapes(*(part[sets] for part in parts))


@pytest.mark.parametrize("steps", [THERE_AND_BACK, (replace(WIDE, depth=16.0),)])
def test_invalid_numbers_affect_no_other_set(steps):
    """Also where the bad set is the first, or fills a block of its own."""
    good = broad(40, steps=steps)
    bad = np.array([[np.nan, 1.0], [1.0, np.inf], [0.0, 1.0], [1.0, -2.0]])
    at = np.array([0, 0, 17, 40])
    mixed = replace(
        good,
        mu=np.insert(good.mu, at, bad, axis=0),
        shape=np.insert(good.shape, at, 1.0, axis=0),
        offset=np.insert(good.offset, at, 0.1),
    )
    shapes = one(mixed)
    lost = at + np.arange(4)
    assert_same_bits(part(shapes, np.delete(np.arange(44), lost)), one(good))
    assert np.isnan(shapes.u[lost]).all() and np.isnan(shapes.constraints[lost, 1:, 1]).all()
    assert [shapes[k].status for k in lost] == ["non-finite"] * 4 and shapes.converged.sum() == 40
    np.testing.assert_array_equal(shapes.x[lost], np.tile(shapes.x[lost[0] + 2], (4, 1)))


def thin(offset, thickness, friction=0.0):
    tissue = Tissue(mu=[0.2], alpha=[1.0], thickness=[thickness], friction=[friction])
    return Batch(NEEDLE, tissue, (Step(10.0, Bevel(0.1)),), offset=offset)


def test_different_insertions_come_back_in_their_order():
    """The longest is begun first, a shallow one with many sets takes the other core."""
    rng = default_rng(7)
    depths, sizes = [3.3, 41.0, 12.6, 0.4, 24.0, 1.0], [70, 3, 33, 1, 32, 5]
    batches = [
        broad(size, n, (Step(depth, Bevel(0.1), WIDE.controls),))
        for n, (depth, size) in enumerate(zip(depths, sizes, strict=True))
    ]
    batches.append(Batch(NEEDLE, TISSUE, random_steps(rng, 3), offset=[0.01, 0.02]))
    batches.append(thin([0.2, 0.001], 0.05))
    found = simulate_batches(batches)
    assert [len(shapes) for shapes in found] == [*sizes, 2, 2]
    assert [shapes[0].depth for shapes in found[:6]] == depths
    for batch, shapes in zip(batches, found, strict=True):
        assert_same_bits(shapes, one(batch, 1))
    assert simulate_batches([]) == ()


def test_what_the_memory_held_before_changes_no_bit(monkeypatch):
    held, make = replace(WIDE, depth=40.2, controls=HELD), native.make_memory

    def fill(value):
        def make_filled(size):
            memory = make(size)
            memory[:] = value
            return memory

        monkeypatch.setattr(native, "make_memory", make_filled)
        return one(broad(40, steps=(WIDE, replace(WIDE, depth=30.2), held), tissue=RUBBING))

    assert_same_bits(fill(np.nan), fill(0.0))
