"""What lies over the needle, against what is known of it: errors and bands."""

import dataclasses
import json
import math
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
from inference_cases import TRUTH, dataset, insertion, measure, medium
from numpy.testing import assert_allclose
from page_files import PAGE
from page_state import compute_band
from pytest import approx

from needlefit.geometry.curves import arc_length, compare_curves
from needlefit.geometry.frames import align_rigid
from needlefit.inference.compared_points import align_points
from needlefit.inference.forward_model import predict, select_layer_draws
from needlefit.inference.likelihood.observations import select_points
from needlefit.mechanics.control import Guide
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.tissue import Tissue
from needlefit.planning.insertion_scene import make_scene_record
from needlefit.planning.steering import StartedInsertion
from needlefit.viewer.overlays import make_measured_overlay
from needlefit.viewer.page_needle import encode_measured

PLAN = insertion(40.0, [17.5], (1, 2))
MEASURED = measure(TRUTH, medium(), PLAN)
OFF = {**TRUTH, "mu1_pa": 2e5, "bevel_mm": 0.1}


def straight(depth, status="converged"):
    x, none = np.array([depth - 150.0, depth]), np.zeros(2)
    cut = np.zeros((1, 3)), np.zeros((1, 4))
    return NeedleShape(x, none, none, none, none, *cut, status, 0)  # type: ignore[arg-type]


def oblique(angle, depth=40.0):
    """A measured needle that runs straight at an angle to the entry axis."""
    s = np.linspace(0, depth, 9)
    planar = s[:, None] * [math.cos(angle), math.sin(angle)]
    return insertion(depth).with_points(planar)


def of(one, pose="known", floor=0.2, shape=None, drop=0.0):
    return make_measured_overlay(
        dataset([one], pose=pose, drop=drop), one, floor, shape or straight(one.depth)
    )


ERRORS = """
import {readFileSync} from 'node:fs'
const {computeErrors} = await import(MODULE)
const {measured, depths} = JSON.parse(readFileSync(0, 'utf8'))
const positions = (s) => s.flatMap((one) => [one, 0])
const straight = (depth) => ({shape: {x: [depth - 150, depth], depth, planes: 1}, positions})
console.log(JSON.stringify(depths.map((depth) => computeErrors(straight(depth), measured))))
"""


def page_errors(overlay, *depths):
    """The errors, on the page, of straight needles of some depths."""
    program = ERRORS.replace("MODULE", repr((PAGE / "model" / "errors.js").as_uri()))
    job = {"measured": {"depth_mm": overlay.depth, **encode_measured(overlay)}, "depths": depths}
    done = subprocess.run(
        ["node", "--input-type=module", "-e", program], input=json.dumps(job), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no Node.js")


@needs_node
def test_errors_up_to_the_depth_in_common():
    angle, depths = 0.05, (12.5, 39.999, 40.0, 55.0)
    for depth, found in zip(depths, page_errors(of(oblique(angle)), *depths), strict=True):
        upto = min(depth, 40.0)
        chord = 2 * upto * math.sin(angle / 2)
        assert found["te_mm"] == approx(chord)
        assert found["ipe_mean_mm"] == approx(chord / 2)
        assert found["edp_percent"] == approx(100 * chord / (upto * math.sin(angle)))
        assert (found["upto_mm"], found["whole"]) == (upto, depth == 40.0)


@needs_node
def test_a_shape_of_unknown_pose_lies_on_the_needle_and_is_compared_where_it_is_whole():
    turned = MEASURED.points[:, :2] @ [[0.0, 1.0], [-1.0, 0.0]] + [30.0, -4.0]
    free = MEASURED.with_points(turned)
    shape = predict(OFF, medium(), free)
    one = of(free, "free", shape=shape, drop=5.0)
    flat = straight(40.0)
    goal = select_points("free", 5.0, free)
    expected = compare_curves(*align_points(goal, lambda s: compute_positions(flat, s)))
    part, whole = page_errors(one, 30.0, 40.0)
    assert part is None and whole["te_mm"] == approx(expected.tip_error)
    onto = compute_positions(shape, one.s)[:, :2]
    assert np.linalg.norm(one.points[:, :2] - onto, axis=1).max() < 0.3  # from 30 mm away
    assert_allclose(align_rigid(one.points[:, :2], onto), one.points[:, :2], atol=1e-9)
    assert arc_length(one.points)[-1] == approx(35.0, abs=0.05)


@needs_node
def test_a_needle_whose_entry_is_its_first_point_is_compared_after_a_shift_across():
    """It runs straight at an angle, from 3 mm beside the axis: a shift leaves half of the slope's error."""
    angle = 0.05
    one = oblique(angle)
    one = dataclasses.replace(
        one.with_points(one.points + np.array([0.0, 3.0, 0.0])), pose_source="first_point"
    )
    overlay = of(one)
    assert overlay.points[:, 1].mean() == approx(0.0, abs=1e-9)  # it lies on the straight needle
    for depth, found in zip((20.0, 40.0), page_errors(overlay, 20.0, 40.0), strict=True):
        across, along = depth * math.sin(angle) / 2, depth * (1 - math.cos(angle))
        assert found["te_mm"] == approx(math.hypot(across, along))
        assert found["whole"] == (depth == 40.0)
    flat = straight(40.0)
    goal = select_points("known", 0.0, one)
    expected = compare_curves(*align_points(goal, lambda s: compute_positions(flat, s)))
    assert expected.tip_error == approx(found["te_mm"])


SCENE = Scene.from_record(make_scene_record(TRUTH, medium(), dataset([PLAN]).name, PLAN))


def spread(count=60):
    rng = np.random.default_rng(3)
    factors = np.exp(0.2 * rng.normal(size=(count, 3)))
    names = ["mu1_pa", "mu2_pa", "bevel_mm"]
    draws = {name: TRUTH[name] * factors[:, n] for n, name in enumerate(names)}
    alphas = {f"alpha{n}": rng.uniform(-30.0, 30.0, count) for n in (1, 2)}  # so far that they tell
    return select_layer_draws(pd.DataFrame(draws | alphas), (1, 2), "ogden")


def led():
    """A needle as a hand leads it: the bevel flips, the base moves, a guide is set."""
    first = SCENE.steps[0]
    session = Session(SCENE.needle, SCENE.tissue, first.bevel, 0.7, rules=SCENE.rules)
    session.step(15.0)
    session.step(10.0, bevel=dataclasses.replace(first.bevel, side=-1, offset=0.02))
    session.step(-3.0, base=(0.8, 0.01))
    session.step(5.0, guides=(Guide(-20.0, 0.3, 0.0),))
    return session


def band(draws, path, first_cell=1.0):
    rules = dataclasses.replace(SCENE.rules, first_cell=first_cell)
    return compute_band(StartedInsertion(SCENE.needle, SCENE.tissue, rules, path, draws))


def test_the_band_covers_the_needles_of_all_draws_under_the_same_inputs():
    session, drawn = led(), spread()
    found = band(drawn, session.input_path(), 0.7)
    s = np.linspace(0.0, session.depth, len(found.x))
    heights, x = [], []
    for mu, shape, offset in zip(drawn.mu, drawn.shape, drawn.bevel, strict=True):
        tissue = Tissue(mu, shape, SCENE.tissue.boundaries, SCENE.tissue.thickness)
        points = compute_positions(session.simulate_again(tissue, offset).now.shape, s)
        x.append(points[:, 0])
        heights.append(points[:, 1])
    low, high = np.percentile(heights, (2.5, 97.5), axis=0)
    assert (found.low <= low + 1e-6).all() and (found.high >= high - 1e-6).all()
    inside = (found.low - 1e-6 <= heights) & (heights <= found.high + 1e-6)
    assert inside.all(axis=1).sum() == 58  # of 60 whole needles; the pointwise band holds fewer
    assert_allclose(found.x, np.median(x, axis=0), atol=1e-6)
    assert found.failed == 0 and np.all(np.diff(found.high - found.low)[-10:] > 0)  # widest at the tip
