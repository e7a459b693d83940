"""Whether a solution keeps to what the model assumes: known answers; and limits on every size."""

import time
import warnings
from dataclasses import replace

import numpy as np
import pytest
from mechanics_cases import pick
from needle_loads import map_beam_points
from pytest import approx
from refusals import refusal

from needlefit import (
    Batch,
    Bevel,
    Controls,
    Guide,
    ModelOptions,
    Needle,
    Session,
    Step,
    Tissue,
    TrackedTip,
    compute_stress,
    linearize,
    simulate,
    simulate_batches,
    simulate_steps,
)
from needlefit.errors import ModelError
from needlefit.mechanics.native import make_flat
from needlefit.mechanics.plan import Lattice, count_element_solves, make_moves, make_stops
from needlefit.mechanics.shape import LIMITS, MAX_MISS_MM, NeedleShape, compute_positions, find_worst
from needlefit.project.unit_warnings import needle_warnings
from needlefit.schemas.limits import MAX_ELEMENT_SOLVES, MAX_ELEMENTS, MAX_GUIDES, MAX_LAYERS
from needlefit.schemas.scene import NeedleRecord

NEEDLE = Needle(150.0, 1.0216e4)
TISSUE = Tissue(np.array([0.2, 33.0]), np.array([1.0, -1.0]), np.array([12.0]))


def beam(x, u, slope):
    """A beam without tissue, of which the tip has always stood where it stands."""
    x, u, slope = (np.array(values, dtype=float) for values in (x, u, slope))
    flat = make_flat(x.shape)
    here = np.array([[x[-1], u[-1], 0.0]])
    track = np.array([[u[-1], slope[-1], 0.0, 0.0]])
    return NeedleShape(x, u, slope, flat, flat, here, track, "converged", 0, np.array([10.0, 40.0]))


def test_a_cantilever_and_a_clamped_needle_have_the_slope_of_the_textbook():
    """By an end force 3 d / 2 L at the tip; between two clamps as much halfway."""
    found = beam([0, 100], [0, 12], [0, 0.18]).validity
    assert (found.max_slope, found.deflection_per_length) == approx((0.18, 0.12)) and found.ok
    assert beam([0, 100], [0, 8], [0, 0]).validity.max_slope == approx(0.12)


def test_shortening_and_the_miss_of_the_entry_have_their_closed_forms():
    slope = 0.25
    found = beam([0, 40, 100], [0, 10, 25], [slope] * 3).validity
    assert found.shortening_per_layer == approx(100 * (1 - np.cos(slope)) / 10)
    # A tilted needle misses all that holds it by the integral of u' - sin u'.
    assert found.miss_mm == 0
    found = beam([-60, -30, 0, 40], [-15, -7.5, 0, 10], [slope] * 4).validity
    assert found.miss_mm == approx(60 * (slope - np.sin(slope)))
    steep = simulate(NEEDLE, TISSUE, Bevel(0.1), 25.0, Controls(base_y=25.0, base_slope=-0.3))
    assert steep.validity.miss_mm > MAX_MISS_MM and "miss" in " ".join(steep.validity.faults)


def test_compression_and_what_is_not_valid():
    shape = simulate(NEEDLE, TISSUE, Bevel(0.3), 55.0)
    at = shape.constraints[:, 0]
    away = np.abs(compute_positions(shape, at) - map_beam_points(shape, shape.constraints))[:, 1]
    assert shape.validity.compression == approx(away.max() / 40.0, rel=1e-6)
    found = simulate(NEEDLE, replace(TISSUE, is_checked=True), Bevel(30.0), 55.0)
    assert not found.converged and not found.valid and not found.validity.ok
    assert found.validity.faults == () and np.isnan(found.validity.max_slope)
    good = simulate(NEEDLE, TISSUE, Bevel(0.1), 55.0)
    assert find_worst([good.validity, found.validity]) == good.validity


def test_a_batch_finds_what_each_of_its_sets_finds():
    rng = np.random.default_rng(3)
    mu = np.exp(rng.uniform(np.log(0.02), np.log(50), (70, 2)))
    guided = Controls(guides=(Guide(-30.0),))
    batch = Batch(
        NEEDLE, TISSUE, (Step(55.4, Bevel(0.1), guided),), mu=mu, offset=np.linspace(0.0, 1.5, 70),
        rigidity=np.linspace(3e3, 4e4, 70), guide_x=np.linspace(-60, -5, 70),
    )  # fmt: skip
    (shapes,) = simulate_batches([batch], 1)
    valid = shapes.valid
    assert 5 < valid.sum() < 65
    for i in range(len(batch)):
        alone, one = simulate_steps(*pick(batch, i)), shapes[i]
        assert alone.valid == one.valid == valid[i]
        for name, _, _ in LIMITS:
            each = getattr(shapes.validity, name)[i]
            assert float(getattr(one.validity, name)) == approx(each, rel=1e-12, nan_ok=True)
            assert float(getattr(alone.validity, name)) == approx(each, rel=1e-5, abs=1e-9, nan_ok=True)


# ---- what is refused


def make_layers(**wrong):
    return Tissue(**{"mu": np.ones(2), "alpha": np.ones(2), "boundaries": [5.0]} | wrong)


def make_batch(**given):
    return Batch(NEEDLE, TISSUE, (Step(14.2, Bevel(0.1)), Step(17.2, Bevel(0.1, -1))), **given)


def insert(depth, *guides, length=150.0):
    steps = Step(1.0, Bevel()), Step(depth, Bevel(), Controls(guides=guides))
    return make_stops(make_moves(steps, length), FULL)


FULL, ANGLE = Lattice(1.0, 1.0), ModelOptions(advance="path_angle")
TWISTED = replace(TISSUE, torsional_friction=0.5)
TURNED = (Step(15.0, Bevel(0.1)), Step(25.0, Bevel(0.1, -1)))
REFUSED = [
    *[lambda x=x: Controls(guides=(Guide(x, 0, None, x >= 0), Guide(x, 0.1, None, x >= 0)))
      for x in (-3.0, 4.5)],
    *[lambda x=x: Guide(x, in_tissue=x < 0) for x in (3.0, 0.0, -3.0)],
    # 1 kPa tissue with 0.02 mm elements would be 3 % off, and look converged
    lambda: ModelOptions(1.0, 0.04), lambda: ModelOptions(tangent=0.5, advance="path_angle"),
    lambda: simulate(NEEDLE, TISSUE, Bevel(0.1), 5.0, rules=ANGLE),
    lambda: make_layers(mu=[0.2, -1.0]), lambda: make_layers(mu=[0.2, 842.0]),  # Pa of brain
    *[lambda x=x: Needle.from_tube(150.0, 1.27, x) for x in (80.0, 8e10)],
    lambda: compute_stress(1.0, 1.0, np.array([80.0, 100.0]), "true"),
    lambda: make_layers(thickness=[0.0, 40.0]),
    *[lambda x=x: Tissue([0.2, 0.1, 0.2], alpha=1, boundaries=x) for x in ([20, 20], [0, 20], [30, 20])],
    lambda: make_layers(friction=[0.0, -0.1]),
    lambda: Tissue([0.2, 3.0], {"jm": [0.1, 5.0]}, [10.0], law="gent"),
    lambda: Tissue([0.2], {"alpha": 1.0, "beta": -2.0}, law="two_term_ogden"),
    lambda: Tissue([0.2], {"alpha": 1.0, "jm": 5.0}, law="ogden"),
    *[lambda x=x: Session(NEEDLE, TISSUE, Bevel(), x) for x in (0.0, 1.2, np.nan)],
    lambda: Session(NEEDLE, TISSUE, Bevel(), controls=Controls(guides=(Guide(-151.0),))),
    lambda: insert(150.0), lambda: insert(140.0, Guide(-10.0)),
    lambda: insert(40.0, Guide(-15.0), length=0.15), lambda: make_moves((), 150.0),
    make_batch, lambda: make_batch(mu=[[1.0, 2.0, 3.0]]),
    lambda: make_batch(offset=[0.1, 0.2], base_y=[0.0]), lambda: make_batch(guide_x=[-3.0]),
    lambda: Batch(NEEDLE, TWISTED, TURNED, rigidity=np.ones(2)),
    lambda: Controls(base_y=np.nan), lambda: Guide(np.nan), lambda: TrackedTip(np.inf),
    lambda: Bevel(0.1, 0), lambda: Bevel("a"), lambda: Step(-1.0, Bevel()),
    lambda: ModelOptions(tolerance=np.inf), lambda: ModelOptions(advance="along"),
    # sizes
    lambda: Needle(1e7, 1e4), lambda: Step(9e8, Bevel(0.1)),
    lambda: Tissue(np.ones(MAX_LAYERS + 1), np.ones(1), np.arange(1.0, MAX_LAYERS + 1)),
    lambda: Controls(guides=tuple(Guide(-1.0 - n) for n in range(MAX_GUIDES + 1))),
    lambda: simulate(Needle(4000.0, 1e4), TISSUE, Bevel(0.0), 3000.0, rules=ModelOptions(0.1, 0.1)),
    lambda: simulate_steps(NEEDLE, TISSUE, [Step(d, Bevel(0.0)) for d in (140.0, 1.0) * 3000]),
]  # fmt: skip


@pytest.mark.parametrize("build", REFUSED)
def test_what_cannot_be_simulated_is_refused_at_once(build):
    began = time.process_time()
    refusal(ModelError, "", build)
    assert time.process_time() - began < 1.0


def test_sessions_and_the_deepest_insertion_are_bounded():
    session = Session(Needle(4000.0, 1e4), TISSUE, Bevel(0.0), 0.1, rules=ModelOptions(0.1, 0.1))
    session.step(insert=5.0)
    refusal(ModelError, "", session.step, insert=MAX_ELEMENTS * 0.1)
    assert session.depth == 5.0
    assert count_element_solves((float(MAX_ELEMENTS),), 1.0, 1.0) <= 1.01 * MAX_ELEMENT_SOLVES
    assert count_element_solves((float(MAX_ELEMENTS), 1.0) * 2, 1.0, 1.0) > 1.01 * MAX_ELEMENT_SOLVES


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"depth": 0.02}, "depth"),
        ({"rigidity": 0.0255}, "flexural_rigidity"),
        ({"boundary": 0.02}, "boundaries"),
        ({"offset": 8e-5}, "offset"),
        ({"mu": 2e-4}, "mu"),
        ({}, ""),
    ],
)
def test_units_are_judged_whatever_is_called(values, named):
    given = {"depth": 50.0, "rigidity": 25500.0, "boundary": 12.0, "offset": 0.085, "mu": 0.2} | values
    needle, bevel = Needle(200.0, given["rigidity"]), Bevel(given["offset"])
    tissue = Tissue([given["mu"], 0.3], alpha=1.0, boundaries=[min(given["boundary"], given["depth"] / 2)])
    steps = (Step(given["depth"], bevel),)
    for call in (
        lambda: simulate(needle, tissue, bevel, given["depth"]),
        lambda: linearize(needle, tissue, bevel, given["depth"]),
        lambda: Batch(needle, tissue, steps, mu=np.array([[0.2, 0.3]])),
    ):
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            call()
        assert {str(one.message).split("`")[1] for one in found} == ({named} if named else set())


@pytest.mark.parametrize(("modulus", "is_doubted"), [(3600, 0), (8700, 1), (17000, 0), (60000, 0), (2e5, 0)])
def test_a_modulus_that_no_needle_has_is_warned_of(modulus, is_doubted):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        Needle.from_tube(200, 1.27, modulus)
    record = NeedleRecord(length_mm=200, outer_diameter_mm=1.27, youngs_modulus_gpa=modulus / 1e3)
    assert len(found) == len([*needle_warnings(record, str)]) == is_doubted
