"""The loop with feedback: exact derivatives, weights in closed form, errors."""

import contextlib
import io
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.random import default_rng
from pytest import approx
from refusals import refusal

import needlefit
from needlefit.errors import ModelError
from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics.control import Guide, TrackedTip
from needlefit.planning.draw_weights import SteeredDraws
from needlefit.studies.steering import Steering

SCENE = tomllib.loads("""
depth_mm = 80.0
needle = { length_mm = 150.0, outer_diameter_mm = 1.27, youngs_modulus_gpa = 80.0 }
bevel.offset_mm = 0.1
layers = [{ top_mm = 0.0, mu_pa = 5e3, alpha = 1.0 }, { top_mm = 25.0, mu_pa = 2e4, alpha = 1.0 }]
""")


def medium(mu_factor=1.8, b_factor=1.4):
    def prior(median, factor):
        return {"bounds": [median / 1e3, median * 1e3], "prior": {"median": median, "factor": factor}}

    moduli = {"mu1_pa": prior(5e3, mu_factor), "mu2_pa": prior(2e4, mu_factor)}
    exact = {"alpha1": {"fixed": 1.0}, "alpha2": {"fixed": 1.0}}
    return {"layers": 2, "parameters": moduli | exact | {"bevel_mm": prior(0.1, b_factor)}}


EXACT = medium(1 + 1e-9, 1 + 1e-9)


def steer(known=None, **options):
    return Steering(known or medium(), SCENE, **{"draws": 200, **options})


def change(step, depth=None, **base):
    return replace(
        step, depth=step.depth if depth is None else depth, controls=replace(step.controls, **base)
    )


@pytest.mark.parametrize("depth", [47.3, 60.0])
def test_the_jacobian_is_that_of_the_last_inputs_by_differences_of_the_simulator(depth):
    steering = steer(EXACT, draws=1, gain_sd=0.0)
    steering.advance([change(steering.now, 20.0), change(steering.now, 47.3, base_y=0.8)])
    (drawn, _), path = steering.draws, (change(steering.now, 20.0, base_y=0.0), steering.now)
    rules = replace(steering.rules, tolerance=1e-10)

    def tip(deeper=0.0, roll=0.0, base_y=0.0, base_slope=0.0):
        now = replace(steering.now, bevel=replace(steering.now.bevel, roll_deg=np.degrees(roll)))
        last = change(now, depth + deeper, base_y=0.8 + base_y, base_slope=base_slope)
        (shapes,) = needlefit.simulate_batches(
            [drawn.make_batch(steering.needle, steering.tissue, (*path, last), rules)], 1
        )
        return needlefit.compute_positions(shapes[0], np.array([depth + deeper]))[0]

    step = 1e-4
    ways = ({"base_y": step}, {"base_slope": step}, {"roll": step})
    differences = [(tip(**way) - tip(**{k: -v for k, v in way.items()})) / (2 * step) for way in ways]
    found = steering.jacobian(depth)
    assert found[:, :3] == approx(np.stack(differences, axis=1), abs=2e-6)
    assert found[:, 3] == approx((tip(1e-3) - tip()) / 1e-3, abs=1e-5)
    assert found[0, 3] == approx(1.0, abs=0.01)


def test_weights_are_the_normal_distribution_where_the_tip_is_linear():
    """Of a slope alone: y = y0 + slope x, so precisions add; few draws are left, and new ones are made."""
    steering, prior_sd, sd, truth = steer(EXACT, draws=1000, gain_sd=0.0, slope_sd=0.05), 0.05, 0.1, -0.03
    expected, precision, moment, rounds = steering.predict(80.0).mean[0], prior_sd**-2, 0.0, 0
    for depth in (20.0, 40.0, 60.0):
        steering.advance(change(steering.now, depth))
        straight = needlefit.simulate_steps(steering.needle, steering.tissue, (steering.now,), steering.rules)
        y = needlefit.compute_positions(straight, np.array([depth]))[0, :2]
        rounds += steering.measure((y[0], y[1] + truth * y[0] + 0.05), sd=sd).rounds
        precision, moment = precision + (y[0] / sd) ** 2, moment + y[0] * (truth * y[0] + 0.05) / sd**2
    draws, weights = steering.draws
    mean = weights @ draws.slope
    assert rounds > 0 and steering.effective > 200
    assert mean == approx(moment / precision, abs=3 * precision**-0.5 / np.sqrt(steering.effective))
    assert np.sqrt(weights @ (draws.slope - mean) ** 2) == approx(precision**-0.5, rel=0.1)
    assert abs(expected - steering.predict(80.0).mean[0]) > 1.0


def test_sigma_points_have_the_mean_and_the_covariance_of_the_weighted_draws():
    rng = default_rng(1)
    known = ParameterDraws(np.exp(rng.normal(size=(60, 2))), np.ones((60, 1, 2)), np.exp(rng.normal(size=60)))
    draws = SteeredDraws.begin(known, 60, 0.25, 0.0, rng)
    draws = replace(draws, log_weights=rng.normal(size=60))

    def list_logarithms(some):
        return np.column_stack([np.log(some.mu), np.log(some.bevel), some.gain])

    every, points = (list_logarithms(one) for one in (draws.to_parameters(), draws.list_sigma_points()))
    assert len(points) == 8
    assert points.mean(axis=0) == approx(draws.weights @ every)
    assert np.cov(points, rowvar=False, bias=True) == approx(
        np.cov(every, rowvar=False, aweights=draws.weights, ddof=0)
    )
    exact = steer(EXACT, draws=1, gain_sd=0.0)
    assert exact._draws.list_sigma_points().bevel == approx([0.1])


def test_every_kind_of_measurement_is_expected_where_the_needle_is():
    """Of exact draws: each value is off by what was added to it, in standard deviations."""
    steering, from_tip = steer(EXACT, draws=1, gain_sd=0.0), np.array([10.0, 25.0, 40.0])
    path = change(steering.now, 30.0), change(steering.now, 60.0, base_y=1.0)
    steering.advance(path)
    shape = needlefit.simulate_steps(steering.needle, steering.tissue, path, steering.rules)
    tip, *points = needlefit.compute_positions(shape, 60.0 - np.append(0.0, from_tip))[:, :2]
    before, here, behind = (needlefit.compute_positions(shape, 60.0 - from_tip + h)[:, 1] for h in (-1, 0, 1))
    curvatures = np.column_stack([from_tip, 1e3 * (before - 2 * here + behind)])
    for kind, values, tolerance in (
        ("tip", tip, 1e-3),
        ("shape", points, 0.02),
        ("curvatures", curvatures, 1e-3),
    ):
        found = steering.measure(np.add(values, (0.0, 0.2)), kind, sd=0.1)
        assert found.surprise == approx(2.0, abs=tolerance), kind


def test_an_error_changes_nothing():
    steering = steer(draws=50)
    steering.advance(change(steering.now, 30.0))
    y = float(steering.predict().mean[0])
    steering.measure((30.0, y), sd=0.3)
    now, before, weights = steering.now, steering.predict(60.0).mean, steering.draws[1]
    guided = replace(now.controls, guides=(Guide(-20.0),))
    held = replace(now.controls, tip=TrackedTip(0.0))
    for words, call in {
        "is 30.0 mm deep": lambda: steering.measure((55.0, y), sd=0.3),
        "at 31.0 mm": lambda: steering.measure([(10.0, 0.0), (31.0, y)], "shape", sd=0.1),
        "of shape": lambda: steering.measure([(10.0, np.nan)], "shape", sd=0.1),
        "SD of 0": lambda: steering.measure((30.0, y), sd=0.0),
        "'curve' with": lambda: steering.measure([(10.0, 0.0)], "curve", sd=0.1),
        "another strength": lambda: steering.advance(replace(now, bevel=replace(now.bevel, offset=0.3))),
        "other guides": lambda: steering.advance(replace(now, controls=guided)),
        "by its tip": lambda: steering.advance(replace(now, controls=held)),
        "cannot be inserted": lambda: steering.advance([change(now, 50.0), change(now, 160.0)]),
        "a depth of 20 mm": lambda: steering.predict(20.0),
    }.items():
        refusal(ModelError, words, call)
        assert steering.now == now and np.array_equal(steering.predict(60.0).mean, before)
        assert np.array_equal(steering.draws[1], weights)


def test_the_loop_of_the_guide_prints_what_it_shows():
    guide = (Path(__file__).parents[1] / "docs/guides/steering.md").read_text(encoding="utf-8")
    ((code, shown),) = re.findall(r"```python\n(.*?)```\s*```text\n(.*?)```", guide, re.DOTALL)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, {})
    assert printed.getvalue() == shown


def test_tissue_that_follows_the_base_bends_the_needle_less_and_moves_it():
    steering = steer(EXACT, draws=1, gain_sd=0.0)
    (drawn, _), start = steering.draws, steering.now

    def find_tip(draws, base_y):
        path = (change(start, 20.0), change(start, 60.0, base_y=base_y))
        batch = draws.make_batch(steering.needle, steering.tissue, path, steering.rules)
        (shapes,) = needlefit.simulate_batches([batch], 1)
        return draws.find_points(shapes, np.array([60.0]), path)[0, 0]

    followed = find_tip(replace(drawn, carried=np.array([0.3])), 2.0)
    assert followed == approx(np.add(find_tip(drawn, 0.7 * 2.0), (0.0, 0.3 * 2.0, 0.0)), abs=1e-12)
