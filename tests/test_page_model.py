"""The needle that the page simulates, run in Node.js: the same bytes as the program's after every step."""

import shutil
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from needle_loads import map_beam_points
from numpy.testing import assert_allclose
from page_files import run_node
from pytest import approx

from needlefit.errors import ModelError
from needlefit.inference.curve_bands import find_bands
from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics import native
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.shape import compute_positions, list_planes
from needlefit.mechanics.simulate import compute_lateral_load
from needlefit.planning.steered_needle import Change, SteeredNeedle, make_steered_scene
from needlefit.reporting.needle_page import encode_draws
from needlefit.schemas.scene import SceneRecord
from needlefit.studies.needle_placement import BAND_PROBABILITY, NEEDLE_POINTS
from needlefit.viewer.measured import ViewedScene
from needlefit.viewer.opening import open_target
from needlefit.viewer.page_needle import encode_scene

pytestmark = pytest.mark.skipif(
    shutil.which("node") is None or not (native.FOLDER / "kernel.wasm").is_file(),
    reason="no Node.js, or a system compiler has built no WebAssembly",
)

PROGRAM = """
import {readFileSync} from 'node:fs'
import {compile, Session} from KERNEL
const load = (name) => import(PAGE + 'model/' + name)
const [{SteeredNeedle}, {describeState}, {computeBand}, {computeValidity}] = await Promise.all(
  ['steered.js', 'state.js', 'band.js', 'validity.js'].map(load))
const {scene, orders, draws} = JSON.parse(readFileSync(0, 'utf8'))
const kernel = await compile(readFileSync(WASM))
const hex = array => Buffer.from(array.buffer, array.byteOffset, array.byteLength).toString('hex')
const steered = await SteeredNeedle.begin(kernel, scene)
const found = []
for (const {changes, keep, forget} of orders) {
  if (keep) steered.keep()
  let fault = null
  try {
    steered.apply(changes)
  } catch (error) {
    if (!error.expected) throw error
    fault = error.what
  }
  const {x, u, slope, constraints} = steered.session.shape
  found.push({fault, tip: steered.tipLateral, shape: [x, u, slope, constraints].map(hex),
    path: steered.session.path(), state: describeState(steered),
    load: Array.from(steered.session.load([0, 0.4, 1].map((part) => part * steered.session.shape.depth))),
    validity: computeValidity(steered.session.shape, steered.model)})
}
const steps = steered.session.path()
const session = await Session.begin(kernel, steered.model, steps[0].inputs)
console.log(JSON.stringify({found, band: computeBand(session, draws, steps)}))
"""


SCENE = """
schema = 1
depth_mm = 40.0
needle = { length_mm = 150.0, outer_diameter_mm = 1.27, youngs_modulus_gpa = 80.0 }
guides = [{ x_mm = -25.0, y_mm = 0.0, name = "template" }]
"""


def view_scene(law, rules, bevel, shape):
    layers = [
        {"top_mm": 18.3 * n, "mu_pa": 2e5 * (1 + n), "thickness_mm": 30.0, "shape": one}
        for n, one in enumerate(shape)
    ]
    changes = {"law": law, "rules": rules, "bevel": bevel, "layers": layers}
    record = SceneRecord.model_validate(tomllib.loads(SCENE) | changes)
    return ViewedScene(name="a", title="A", note="", record=record, first_cell=0.6)


SCENES = {
    "measured": lambda: open_target("twin/phantom2-05"),
    "two terms": lambda: view_scene(
        "two_term_ogden", {}, {"offset_mm": 0.08}, 2 * [{"alpha": 1.5, "beta": -1.2, "share": 0.3}]
    ),
    "path angle": lambda: view_scene(
        "ogden",
        {"advance": "path_angle", "constraint_spacing_mm": 2.0},
        {"cut_angle_deg": 1.5},
        3 * [{"alpha": 1.0}],
    ),
    "table": lambda: view_scene("gent", {}, {"offset_mm": 0.05}, 2 * [{"jm": 2.0}]),
    "rolled": lambda: view_scene("ogden", {}, {"offset_mm": 0.1, "roll_deg": 37.0}, 2 * [{"alpha": 1.0}]),
}
SHAPE_VALUES = {"alpha": (0.0, 3.0), "beta": (-3.0, 0.0), "share": (0.0, 1.0)}


def random_orders(rng, scene, count):
    angle, layers = scene.rules.path_angle, scene.tissue.layers
    strength = "cut_angle" if angle else "offset"
    here = "cut_angle_deg" if angle else "bevel_offset_mm"
    orders = []
    depth, kept = 0.0, [0]
    for n in range(count):
        layer = int(rng.integers(1, layers + 1))
        options = [
            [["depth_mm", None, max(0.0, depth + rng.uniform(0.0, 6.0))]],
            [["depth_mm", None, max(0.0, depth + rng.uniform(-6.0, 2.0))]],
            [["bevel_side", None, float(rng.choice([-1, 1]))]],
            [["bevel_roll_deg", None, float(rng.choice([0.0, 90.0, 180.0, -180.0, rng.uniform(-400, 400)]))]],
            [[here, None, rng.uniform(0.0, 0.15) * (20 if angle else 1)]],
            [["base_y_mm", None, rng.uniform(-3.0, 3.0)], ["base_slope", None, rng.uniform(-0.02, 0.02)]],
            [["base_y_mm", None, rng.uniform(-3.0, 3.0)], ["depth_mm", None, depth + 1.0]],
            [["guide_x_mm", 3, -rng.uniform(2.0, 20.0)], ["guide_y_mm", 3, rng.uniform(-0.3, 0.3)]],
            [["guide_turns_freely", 3, float(rng.choice([0, 1]))]],
            [["guide_slope", 3, rng.uniform(-0.02, 0.02)]],
            [["guide_engaged", 3, 0.0]],
            [["guide_x_mm", 4, rng.uniform(1.0, 20.0)], ["guide_y_mm", 4, rng.uniform(-0.1, 0.1)]],
            [["guide_engaged", 4, 0.0]],
            [["tip_held", None, float(rng.choice([0, 1]))]],
            [["tip_y_mm", None, rng.uniform(-0.5, 0.5)]],
            [["mu_pa", layer, 10 ** rng.uniform(4.5, 6.0)]],
            [[f"{strength}_throughout_{'deg' if angle else 'mm'}", None, rng.uniform(0.0, 0.2)]],
            [["mu_pa", layer, 3e5], ["base_y_mm", None, 0.5]],
            [["base_y_mm", None, 60.0]],  # outside the model's validity
            [["base_slope", None, 7.0]],  # refused
            [["return_to", None, float(rng.choice(kept))]],
            *(
                [[name, layer, rng.uniform(*SHAPE_VALUES[name])]]
                for name in LAWS[scene.tissue.law].shape_names
                if name in SHAPE_VALUES
            ),
        ]
        changes = options[0] if n < 3 else options[rng.integers(len(options))]
        if changes[0][0] == "depth_mm":
            depth = changes[0][2]
        orders.append({"changes": changes, "keep": n % 5 == 0})
    return orders


def compute_band(steering, draws):
    """Return depth, ends of y (mm) and failures of the band that holds 95 % of the needles of draws.

    None before the tip is in, and where no draw can be solved.
    """
    path, rules = steering.input_path(), replace(steering.scene.rules, first_cell=steering.first_cell)
    if not path[-1].depth > 0:
        return None
    batch = draws.make_batch(steering.scene.needle, steering.now.tissue, path, rules)
    (shapes,) = simulate_batches([batch], threads=1)
    points = compute_batch_positions(shapes, np.linspace(0.0, path[-1].depth, NEEDLE_POINTS))
    found = points[shapes.converged]  # (B, K, 3)
    if not len(found):
        return None
    across = found[:, :, 1:].transpose(0, 2, 1).reshape(len(found), -1)  # y, then z, which is 0 in a plane
    low, high = (end[:NEEDLE_POINTS] for end in find_bands(across).ends(BAND_PROBABILITY))
    failed = len(shapes) - len(found)
    return {"x": np.median(found[:, :, 0], axis=0), "low": low, "high": high, "failed": failed}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.sweep)])
@pytest.mark.parametrize("name", list(SCENES))
def test_the_page_simulates_the_bytes_of_the_program(name, seed):
    """All inputs, parameters, refusals, returns; what is shown, the path that leads there, all bands."""
    viewed, rng = SCENES[name](), np.random.default_rng(seed)
    scene = make_steered_scene(viewed.record, name)
    steering = SteeredNeedle(scene, viewed.first_cell)
    orders = random_orders(rng, scene, 60)
    draws = ParameterDraws(
        scene.tissue.mu * 10 ** rng.uniform(-0.3, 0.3, (12, 1)),
        np.repeat(scene.tissue.shape[None], 12, axis=0),
        rng.uniform(0.0, 0.1, 12),
        gain=rng.uniform(0.5, 1.5, 12),
    )
    job = {"scene": encode_scene(viewed, steering), "draws": encode_draws(draws, scene.tissue.law)}
    done = run_node(PROGRAM, {**job, "orders": orders})
    refused = 0
    for order, found in zip(orders, done["found"], strict=True):
        if order["keep"]:
            steering.keep()
        try:
            steering.apply([Change(*change) for change in order["changes"]])
        except ModelError:
            assert found["fault"], order
            refused += 1
        else:
            assert found["fault"] is None, order
        shape = steering.now.shape
        assert found["tip"] == shape.tip_lateral
        u, slope = list_planes(shape)
        parts = (shape.x, u, slope, shape.constraints[:, : 1 + len(u)])
        parts = [np.ascontiguousarray(one, dtype=np.float64) for one in parts]
        assert found["shape"] == [one.tobytes().hex() for one in parts]
        state, controls = found["state"], steering.now.step.controls
        assert (state["step"], state["depth_mm"]) == (steering.number, steering.now.step.depth)
        assert (state["tip"]["lateral_mm"], state["max_slope"]) == approx(
            (shape.tip_lateral, shape.validity.max_slope)
        )
        ends = compute_positions(shape, shape.x[[0, -1]])
        for n, axis in enumerate("xyz"[: 1 + len(u)]):
            assert_allclose(np.array(state[axis])[[0, -1]], ends[:, n], atol=2e-4)
            points = map_beam_points(shape, shape.constraints)[:, n]
            assert_allclose(state["constraints"][axis], points, atol=2e-4)
        assert [one["x"] for one in state["guides"]] == [one.x for one in controls.guides]
        assert [one["mu_pa"] for one in state["layers"]] == approx(1e6 * steering.now.tissue.mu)
        s = shape.depth * np.array([0.0, 0.4, 1.0])
        load = compute_lateral_load(shape, steering.now.tissue, s, scene.rules)[: len(u)]
        assert_allclose(found["load"], load.ravel(), rtol=1e-9, atol=1e-12)
        expected = shape.validity
        assert found["validity"] == approx(
            {key: float(getattr(expected, key)) for key in found["validity"]}, rel=1e-9, abs=1e-12
        )
        path = steering.input_path()
        bevels = [(one["depth"], one["inputs"]["bevel"]) for one in found["path"]]
        assert [(depth, bevel["side"], bevel["roll"]) for depth, bevel in bevels] == [
            (one.depth, one.bevel.side, one.bevel.roll_deg) for one in path
        ]
    assert 0 < refused < 40
    band = compute_band(steering, draws)
    if band is not None:
        for key in ("x", "low", "high"):
            assert_allclose(done["band"][key], band[key], atol=1e-7)  # each step ends within 1e-7 mm
        assert done["band"]["failed"] == band["failed"]
