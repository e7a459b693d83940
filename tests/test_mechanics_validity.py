"""Whether a solution keeps to what the model assumes: known answers; and limits on every size."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_bvp

from needlefit.errors import ModelError
from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice, count_element_solves, plan_stops
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import (
    LIMITS,
    MAX_DEFLECTION_PER_LENGTH,
    MAX_MISS_MM,
    MAX_SLOPE,
    NeedleShape,
    compute_positions,
    find_worst,
    map_beam_points,
)
from needlefit.mechanics.simulate import simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.limits import MAX_ELEMENT_SOLVES, MAX_ELEMENTS, MAX_GUIDES, MAX_LAYERS

NEEDLE = Needle(150.0, 1.0216e4)
TISSUE = Tissue(np.array([0.2, 33.0]), np.array([1.0, -1.0]), np.array([12.0]))


def beam(x, u, slope) -> NeedleShape:
    """A beam without tissue, of which the tip has always stood where it stands."""
    x, u, slope = (np.array(values, dtype=float) for values in (x, u, slope))
    here = np.array([[x[-1], u[-1]]])
    track = np.array([[u[-1], slope[-1]]])
    return NeedleShape(x, u, slope, here, track, "converged", 0, np.array([10.0, 40.0]))


def test_a_cantilever_and_a_clamped_needle_have_the_slope_of_the_textbook():
    # An end force: u = d (3 s^2 - s^3) / 2, slope 3 d / 2 L at the tip.
    found = beam([0, 100], [0, 12], [0, 0.18]).validity
    assert found.max_slope == pytest.approx(1.5 * 12 / 100)
    assert found.deflection_per_length == pytest.approx(0.12)
    assert found.ok and found.faults == ()
    assert beam([0, 100], [0, 8], [0, 0]).validity.max_slope == pytest.approx(1.5 * 8 / 100)
    held = Controls(base_y=10.0, guides=(Guide(-20.0),))
    shape = simulate(NEEDLE, TISSUE, Bevel(0.0), 30.0, held)  # base 100 mm before the guide
    assert np.abs(shape.slope).max() < 1e-12
    assert shape.validity.max_slope == pytest.approx(0.15)


def test_shortening_and_the_miss_of_the_entry_have_their_closed_forms():
    slope = 0.25
    found = beam([0, 40, 100], [0, 10, 25], [slope] * 3).validity
    assert found.shortening_per_layer == pytest.approx(100 * (1 - np.cos(slope)) / 10)
    shape = simulate(NEEDLE, TISSUE, Bevel(0.1), 55.0)
    lag = shape.depth - compute_positions(shape, shape.x[-1:])[0, 0]
    base = shape.x[0] - compute_positions(shape, shape.x[:1])[0, 0]
    assert shape.validity.shortening_per_layer * 12.0 == pytest.approx(lag - base, rel=2e-2)
    # A tilted needle misses all that holds it by the integral of u' - sin u'.
    assert found.miss_mm == 0
    found = beam([-60, -30, 0, 40], [-15, -7.5, 0, 10], [slope] * 4).validity
    assert found.miss_mm == pytest.approx(60 * (slope - np.sin(slope)))
    shape = simulate(NEEDLE, TISSUE, Bevel(0.1), 55.0, Controls(base_y=10.0, base_slope=-0.1))
    entry = compute_positions(shape, np.zeros(1))[0, 1]
    assert shape.validity.miss_mm == pytest.approx(abs(entry - shape.u[shape.x == 0.0][0]), rel=1e-2)
    assert 0.02 < shape.validity.miss_mm < MAX_MISS_MM
    steep = simulate(NEEDLE, TISSUE, Bevel(0.1), 25.0, Controls(base_y=25.0, base_slope=-0.3))
    assert steep.validity.miss_mm > MAX_MISS_MM and "miss" in " ".join(steep.validity.faults)


def test_at_the_limit_of_deflection_linear_theory_of_a_cantilever_is_four_per_cent_off():
    linear = MAX_DEFLECTION_PER_LENGTH
    force = 3 * linear  # over EI / L^2

    def bend(_, y):
        return np.vstack((y[1], -force * np.cos(y[0]), np.sin(y[0])))

    s = np.linspace(0, 1, 51)
    guess = np.vstack((1.5 * linear * s, 1.5 * linear * (1 - s), linear * s**2))
    exact = solve_bvp(bend, lambda a, b: np.array([a[0], b[1], a[2]]), s, guess, tol=1e-8).y
    assert linear / exact[2, -1] - 1 == pytest.approx(0.04, abs=1e-3)
    assert np.tan(exact[0, -1]) == pytest.approx(MAX_SLOPE, abs=1e-3)


def test_compression_and_what_is_not_valid():
    shape = simulate(NEEDLE, TISSUE, Bevel(0.3), 55.0)
    at = shape.constraints[:, 0]
    away = np.abs(compute_positions(shape, at) - map_beam_points(shape, shape.constraints))[:, 1]
    assert shape.validity.compression == pytest.approx(away.max() / 40.0, rel=1e-6)
    found = simulate(NEEDLE, TISSUE, Bevel(30.0), 55.0)
    assert not found.converged and not found.valid and not found.validity.ok
    assert found.validity.faults == () and np.isnan(found.validity.max_slope)
    good = simulate(NEEDLE, TISSUE, Bevel(0.1), 55.0)
    assert find_worst([good.validity, found.validity]) == good.validity
    assert simulate(NEEDLE, TISSUE, Bevel(0.02), 50.5, Controls(guides=(Guide(-1e-3),))).valid


def test_the_tip_on_its_way_counts_too():
    """The needle is drawn back; its constraint points were cut at slopes that the model does not know."""
    steps = [Step(50.0, Bevel(0.5)), Step(3.0, Bevel(0.5))]
    out = [simulate_steps(NEEDLE, TISSUE, steps[:n]) for n in (1, 2)]
    assert [shape.valid for shape in out] == [False, True]
    turned = [Step(20.0, Bevel(0.5)), Step(60.0, Bevel(0.5, -1))]
    shape = simulate_steps(NEEDLE, TISSUE, turned)
    assert shape.validity.max_slope >= np.abs(shape.tip_track[:, 1]).max()


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
        alone, one = simulate_steps(*batch.pick(i)), shapes[i]
        assert alone.valid == one.valid == valid[i]
        for name, _, _ in LIMITS:
            each = getattr(shapes.validity, name)[i]
            assert float(getattr(one.validity, name)) == pytest.approx(each, rel=1e-12, nan_ok=True)
            assert float(getattr(alone.validity, name)) == pytest.approx(
                each, rel=1e-5, abs=1e-9, nan_ok=True
            )


@pytest.mark.parametrize("spacing", [1.0, 0.25, 0.1])
@pytest.mark.parametrize("depth", [60.0, 149.9, 149.999, 150.0 - 1e-6])
def test_another_unit_of_force_leaves_rounding_alone(depth, spacing):
    """Also in soft tissue on a fine mesh, and of a stub before the entry."""
    tissue, rules = (Tissue([1e-3], [1.0]) if depth == 60.0 else TISSUE), ModelOptions(spacing, spacing)
    shape = simulate(NEEDLE, tissue, Bevel(0.02 * spacing), depth, rules=rules)
    heavier = replace(NEEDLE, flexural_rigidity=3 * NEEDLE.flexural_rigidity)
    again = simulate(heavier, replace(tissue, mu=3 * tissue.mu), Bevel(0.02 * spacing), depth, rules=rules)
    assert shape.valid and np.abs(again.u - shape.u).max() < 1e-9


@pytest.mark.parametrize(
    "build",
    [
        lambda: Needle(1e7, 1e4),  # 10 km
        lambda: Step(9e8, Bevel(0.1)),
        lambda: Tissue(np.ones(MAX_LAYERS + 1), np.ones(1), np.arange(1.0, MAX_LAYERS + 1)),
        lambda: Needle.from_tube(150.0, 1e100, 80e3),
        lambda: Controls(guides=tuple(Guide(-1.0 - n) for n in range(MAX_GUIDES + 1))),
        lambda: ModelOptions(max_iterations=10**6),
        lambda: ModelOptions(1e9, 1.0),
        lambda: simulate(Needle(4000.0, 1e4), TISSUE, Bevel(0.0), 3000.0, rules=ModelOptions(0.1, 0.1)),
        lambda: simulate_steps(NEEDLE, TISSUE, [Step(d, Bevel(0.0)) for d in (140.0, 1.0) * 3000]),
    ],
)
def test_excessive_sizes_are_refused_at_once(build):
    began = time.monotonic()
    with pytest.raises(ModelError):
        build()
    assert time.monotonic() - began < 1.0


def test_sessions_and_the_deepest_insertion_are_bounded():
    session = Session(Needle(4000.0, 1e4), TISSUE, Bevel(0.0), 0.1, rules=ModelOptions(0.1, 0.1))
    session.step(insert=5.0)
    with pytest.raises(ModelError):
        session.step(insert=MAX_ELEMENTS * 0.1)
    assert session.depth == 5.0
    assert count_element_solves((float(MAX_ELEMENTS),), 1.0, 1.0) <= 1.01 * MAX_ELEMENT_SOLVES
    assert count_element_solves((float(MAX_ELEMENTS), 1.0) * 2, 1.0, 1.0) > 1.01 * MAX_ELEMENT_SOLVES


depths = st.lists(st.floats(0.01, 140.0), min_size=1, max_size=6)


@given(depths, st.floats(0.3, 3.0), st.integers(1, 4))
@settings(max_examples=60)
def test_the_count_of_elements_is_an_upper_bound_and_not_far_off(depths, spacing, parts):
    steps = [Step(depth, Bevel(0.0)) for depth in depths]
    stops = plan_stops(steps, Lattice(spacing, spacing), 150.0)
    element = spacing / parts
    solved = sum(stop.tip / element for stop in stops)
    bound = count_element_solves(tuple(depths), spacing, element)
    assert solved <= bound <= 1.5 * solved + 20 * len(depths) * (1 + 140 / spacing) * parts


@st.composite
def scenes(draw):
    length = draw(st.floats(20.0, 600.0))
    spacing = max(draw(st.floats(0.1, 3.0)), length / 600)
    layers = draw(st.integers(1, 4))
    part = st.floats(0.0, 1.0)
    tissue = Tissue(
        np.array([10.0 ** draw(st.floats(-3, 2)) for _ in range(layers)]),
        np.array([draw(st.floats(-10, 10)) for _ in range(layers)]),
        np.sort([length * draw(part) for _ in range(layers - 1)]),
        np.array([draw(st.floats(5, 80))]),
    )
    steps = [
        Step(
            length * draw(st.floats(0.02, 0.95)),
            Bevel(spacing * 10.0 ** draw(st.floats(-4, 0)), draw(st.sampled_from((1, -1)))),
            Controls(base_y=draw(st.floats(-20, 20)), base_slope=draw(st.floats(-0.3, 0.3))),
        )
        for _ in range(draw(st.integers(1, 4)))
    ]
    return Needle(length, 10.0 ** draw(st.floats(1, 6))), tissue, steps, ModelOptions(spacing, spacing)


@given(scenes())
@settings(max_examples=80)
def test_every_accepted_scene_ends_soon_and_is_flat_where_it_is_valid(scene):
    began = time.process_time()
    shape = simulate_steps(*scene)
    assert time.process_time() - began < 5.0
    assert shape.status in ("converged", "over-compressed", "not converged", "non-finite")
    if shape.valid:
        dense = compute_positions(shape, np.linspace(shape.x[0], shape.depth, 2000))
        assert np.abs(np.gradient(dense[:, 1], dense[:, 0])).max() < MAX_SLOPE + 0.02
        assert np.isfinite(dense).all()
    elif shape.converged:
        assert shape.validity.faults
