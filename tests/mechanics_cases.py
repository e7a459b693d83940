"""Random insertions for tests: any tissue, any inputs, several steps with changes and retractions."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
import reference_solver
from numpy.testing import assert_allclose, assert_array_equal

from needlefit import Batch, Bevel, Controls, Guide, ModelOptions, Needle, Step, Tissue, TrackedTip
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.plan import Lattice

NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)

#: the decided rules; any constraint point, advance and first cell; and the advance by the path angle
RULES = ("decided", "variant", "path_angle")


def list_seeds(count, each=4):
    """Return seeds of random cases: some for each session, the others as a sweep."""
    return [*range(each), *(pytest.param(seed, marks=pytest.mark.sweep) for seed in range(each, count))]


def assert_same_bits(found, expected, but=()):
    """Compare two shapes, Jacobians, or batches of them, `but` some fields."""
    for name in {field.name for field in fields(found)} - set(but):
        assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def pick(batch, i):
    """Return set i of a batch as the arguments of `simulate_steps`."""
    needle, steps = batch.vary_inputs(i)
    if batch.roll is not None:
        roll_deg = math.degrees(float(batch.roll[i]))
        bevels = [replace(one.bevel, roll_deg=one.bevel.roll_deg + roll_deg) for one in steps]
        steps = tuple(replace(one, bevel=bevel) for one, bevel in zip(steps, bevels, strict=True))
    tissue = batch.tissue
    mu, shape = (
        (tissue.mu if batch.mu is None else batch.mu[i]),
        (tissue.shape if batch.shape is None else batch.shape[i]),
    )
    return needle, replace(tissue, mu=mu, shape=shape), steps, batch.rules


def assert_close(found, expected, atol=1e-7):
    assert found.converged and expected.converged
    assert_allclose(found.x, expected.x, atol=1e-9)
    for name in ("u", "slope", "w", "slope_z", "constraints"):
        assert_allclose(getattr(found, name), getattr(expected, name), atol=atol, err_msg=name)
    track = np.isnan(expected.tip_track)  # a retraction may have left a point without its tip
    assert_array_equal(np.isnan(found.tip_track), track)
    assert_allclose(found.tip_track[~track], expected.tip_track[~track], atol=atol)


def assert_derivatives(
    found,
    needle,
    tissue,
    steps,
    rules,
    lattice=None,
    rtol=1e-7,
    part=slice(None),
):
    """Compare a part of the columns of a Jacobian with complex steps; by shape parameters of laws to 1e-5."""
    for p, name in list(enumerate(found.names))[part]:
        nodes, u, slope, points = reference_solver.differentiate(needle, tissue, steps, rules, name, lattice)
        tolerance = 1e-5 if name.rstrip("0123456789") in LAWS[tissue.law].shape_names else rtol
        largest = max(np.abs(u).max(), np.abs(points).max(), 1e-6)
        # a parameter that shifts the needle as a whole hardly turns it: its slopes are but rounding
        steepest = max(np.abs(slope).max(), 0.01 * largest)
        assert_allclose(found.x[:, p], nodes, atol=1e-12, err_msg=name)
        for part, exact, size in ((found.u, u, largest), (found.slope, slope, steepest),
                                  (found.constraints, points, largest)):  # fmt: skip
            assert_allclose(part[..., p], exact, rtol=0, atol=tolerance * size, err_msg=name)


def vary(rng, rules, kind):
    """Return rules of one of the kinds `RULES`."""
    if kind != "variant":
        return rules if kind == "decided" else replace(rules, advance="path_angle")
    return replace(
        rules,
        switch=float(rng.choice([0.0, 1.0, rng.uniform()])),
        tangent=float(rng.choice([0.0, rng.uniform()])),
        first_cell=float(rng.uniform(0.05, 1.0)) * rules.spacing if rng.random() < 0.5 else None,
    )


def adapt(steps, rules):
    """Return the steps with the bevel that the rules know: an offset, or an angle, of the same number."""
    if not rules.path_angle:
        return steps
    return tuple(replace(s, bevel=Bevel(0.0, s.bevel.side, s.bevel.offset)) for s in steps)


def random_case(rng, kind="decided", count=5, deepest=11.0):
    """Return needle, tissue, `count` steps and one more, rules of a kind and, if it is decided, a lattice."""
    rules = vary(rng, random_rules(rng), kind)
    needle, tissue = random_needle(rng, rules), random_tissue(rng, rules, rng.choice([0.0, 0.3]))
    steps = adapt(random_steps(rng, count, deepest=deepest), rules)
    first = None if kind == "variant" else rng.uniform(0.05, 1.0) * rules.spacing
    return needle, tissue, steps, rules, first and Lattice(first, rules.spacing)


def random_rules(rng):
    spacing = float(rng.choice([0.5, 1.0, 2.0]))
    return ModelOptions(spacing, max(spacing / int(rng.choice([1, 2, 4])), 0.25))


def random_rigidity(rng, rules, size=None):
    """Return EI: up to ten times that of 18 gauge steel.

    Short elements of a stiff needle in soft tissue are lost in rounding: 2e-7 mm where all three come
    together, more than is asked for here.
    """
    return 10 ** rng.uniform(3, 5 if rules.element >= 1 else 4.1, size)


def random_mu(rng, rules, size):
    return 10 ** rng.uniform(-3 if rules.element >= 0.5 else -1, 2, size)


def random_needle(rng, rules):
    return Needle(rng.uniform(90, 200), random_rigidity(rng, rules))


def draw_shape(law, rng, size):
    """Return random shape parameters: an array of `size` for each of the law's."""
    drawn = [rng.uniform(*parameter.tested, size) for parameter in law.parameters]
    return np.array(drawn).reshape(len(law.parameters), *size)


def random_tissue(rng, rules, friction=0.0):
    """Return 1 to 4 layers, thin and thick, soft and stiff."""
    layers = int(rng.integers(1, 5))
    law = LAWS[str(rng.choice(LAWS.names()))]
    return Tissue(
        mu=random_mu(rng, rules, layers),
        shape=draw_shape(law, rng, (layers,)),
        boundaries=np.sort(rng.uniform(1, 20, layers - 1)),
        thickness=rng.uniform(5.0, 80.0, layers),
        friction=friction * rng.uniform(size=layers),
        law=law.name,
        is_checked=True,  # values and bevels are drawn from more than needles and tissues have
    )


def random_bevel(rng):
    return Bevel(rng.uniform(0, 0.3), int(rng.choice([-1, 1])))


def random_depth(rng, deepest=22.0):
    """Return any depth, a whole number, or one whose cell has only just begun."""
    whole = int(rng.integers(1, int(deepest)))
    return float(rng.choice([rng.uniform(0.2, deepest), whole, whole + 1e-4]))


def random_guide(rng, x):
    slope = None if rng.random() < 0.5 else rng.uniform(-0.01, 0.01)
    return Guide(x, rng.uniform(-0.2, 0.2), slope, in_tissue=x >= 0)


def random_controls(rng, within=True):
    """Return a base, up to two guides before the tissue and two in it, and now and then a tracked tip."""
    before = [-5.3, -17.9][: int(rng.integers(0, 3))]
    inside = list(rng.choice([0.4, 3.0, 7.77, 12.25], 2, replace=False))[: int(rng.integers(0, 3))]
    slope = None if rng.random() < 0.5 else rng.uniform(-0.02, 0.02)
    tracked = TrackedTip(rng.uniform(-0.2, 0.2), slope) if rng.random() < 0.2 else None
    return Controls(
        rng.uniform(-0.5, 0.5),
        rng.uniform(-0.005, 0.005),
        float(rng.choice([0.0, rng.uniform(-0.01, 0.01)])),
        tuple(random_guide(rng, float(x)) for x in before + (inside if within else [])),
        tracked if within else None,
    )


def random_steps(rng, count, within=True, deepest=22.0):
    """Return steps in any order of depths, 0 among them; the last one stands in the tissue."""
    steps = []
    bevel, controls = random_bevel(rng), random_controls(rng, within)
    for _ in range(count):
        if rng.random() < 0.5:
            bevel = random_bevel(rng)
        if rng.random() < 0.5:
            controls = random_controls(rng, within)
        depth = 0.0 if rng.random() < 0.1 else random_depth(rng, deepest)
        if steps and rng.random() < 0.2:
            depth = steps[-1].depth
        steps.append(Step(depth, bevel, controls))
    return (*steps, Step(random_depth(rng, deepest), bevel, controls))


def random_batch(rng, sets, within=False, friction=0.0, kind="decided"):
    """Return many parameter sets over broad priors; `within`: with guides in the tissue and tracked tips."""
    rules = random_rules(rng)
    needle, tissue = random_needle(rng, rules), random_tissue(rng, rules, friction)
    steps = random_steps(rng, int(rng.integers(0, 5)), within)
    size = (sets, tissue.layers)
    given = {
        "mu": random_mu(rng, rules, size),
        "shape": np.moveaxis(draw_shape(LAWS[tissue.law], rng, size), 0, 1),
        "offset": rng.uniform(0, 0.3, sets),
        "rigidity": random_rigidity(rng, rules, sets),
        "base_y": rng.uniform(-0.5, 0.5, sets),
        "base_slope": rng.uniform(-0.005, 0.005, sets),
    }
    names = [name for name in given if rng.random() < 0.6] or ["mu"]
    if all(len(step.controls.before) == 1 for step in steps) and rng.random() < 0.7:
        names, given["guide_x"] = [*names, "guide_x"], rng.uniform(-30, -2, sets)
    rules = vary(rng, rules, kind)
    if rules.path_angle:
        names, given["cut_angle"] = [name for name in names if name != "offset"], rng.uniform(0, 0.2, sets)
        names.append("cut_angle")
    return Batch(needle, tissue, adapt(steps, rules), rules, **{name: given[name] for name in names})
