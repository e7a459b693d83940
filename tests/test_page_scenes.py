"""What scenes of the page show, run in Node.js: an S, where force goes, where b and a modulus fit alike."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_files import PAGE
from test_page_model import pytestmark  # noqa: F401 - a mark of this module, too

from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics import native
from needlefit.planning.steered_needle import SteeredNeedle, make_steered_scene
from needlefit.viewer.opening import open_target
from needlefit.viewer.page_needle import encode_draws, encode_scene

PROGRAM = """
import {readFileSync} from 'node:fs'
import {compile} from KERNEL
const load = (name) => import(PAGE + name + '.js')
const [{SteeredNeedle}, {listSteps}, probes, plane, {readPoints}] =
  await Promise.all(['steered', 'inputs', 'probes', 'plane', 'errors'].map(load))
const {scene, others} = JSON.parse(readFileSync(0, 'utf8'))
const kernel = await compile(readFileSync(WASM))
const begin = async (draws) => {
  const needle = await SteeredNeedle.begin(kernel, {...scene, draws: draws ?? scene.draws})
  for (const changes of listSteps(scene)) needle.apply(changes, {validOnly: false})
  return needle
}
const needle = await begin()
const found = {ridge: plane.hasRidge(needle), others: []}
for (const draws of others) found.others.push(plane.hasRidge(await begin(draws)))
const {layer, mu} = plane.readDraws(scene)
const tied = plane.findTied(mu, layer)
const times = Array.from({length: 15}, (_, i) => 2 ** ((i - 7) / 7))
const factors = Array.from({length: 11}, (_, i) => 8 ** ((i - 5) / 5))
const strengths = times.map((one) => one * scene.fitted.offset_mm)
const target = plane.makeTarget(needle)
const ms = []
let rows
for (let n = 0; n < 3; n += 1) {
  const began = performance.now()
  rows = await plane.computePlane(kernel, needle, target, {strengths: factors.map(() => strengths), factors, tied})
  ms.push(performance.now() - began)
}
const at = (place, factor) => {
  const changes = tied.map((i) => ['mu_pa', i + 1, scene.fitted.layers[i].mu_pa * factor])
  needle.apply([['offset_throughout_mm', null, place * scene.fitted.offset_mm], ...changes], {validOnly: false})
  return plane.compareWith(target, readPoints(needle.session, target.s))
}
const alone = [[5, 7], [3, 12], [10, 0]].map(([row, column]) => [rows[row][column], at(times[column], factors[row])])
const valley = plane.findValley(rows)
const between = valley.map((one, row) => one && at(2 ** ((one.column - 7) / 7), factors[row]))
const contour = plane.findContour(rows, 0.2).map(([one, other]) => at(2 ** ((one[0] - 7) / 7), 8 ** ((one[1] - 5) / 5)))
const turn = probes.findTurn(await begin())
const turned = await begin()
for (const changes of probes.listTurned(turn ?? 1, scene)) turned.apply(changes, {validOnly: false})
const {x, slope} = turned.session.shape
const stiffer = probes.findStiffer(await begin())
console.log(JSON.stringify({...found, ms, alone, valley, between, contour, turn, slope: [...slope].filter((_, i) => x[i] >= 0), stiffer, rows}))
"""  # noqa: E501


def run(name: str, others: list[Any]) -> Any:
    viewed = open_target(name, first="scene")
    scene = make_steered_scene(viewed.record, name)
    encoded = encode_scene(viewed, SteeredNeedle(scene, viewed.first_cell))
    if encoded["draws"] is None:
        encoded["draws"] = encode_draws(make_draws(scene, -0.9), scene.tissue.law)
    program = PROGRAM.replace("KERNEL", repr((native.FOLDER / "needle.js").as_uri()))
    program = program.replace("PAGE", repr((PAGE / "model").as_uri() + "/"))
    program = program.replace("WASM", repr(str(native.FOLDER / "kernel.wasm")))
    others = [encode_draws(make_draws(scene, one), scene.tissue.law) for one in others]
    command = ["node", "--no-wasm-tier-up", "--input-type=module", "-e", program]
    job = json.dumps({"scene": encoded, "others": others})
    done = subprocess.run(command, input=job, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def make_draws(scene, correlation: float) -> ParameterDraws:
    """Return draws of b and of all moduli, each with this correlation of their logarithms."""
    rng = np.random.default_rng(0)
    b = rng.standard_normal((400, 1))
    other = correlation * b + np.sqrt(1 - correlation**2) * rng.standard_normal((400, scene.tissue.layers))
    shape = np.repeat(scene.tissue.shape[None], 400, axis=0)
    return ParameterDraws(scene.tissue.mu * np.exp(0.2 * other), shape, 0.1 * np.exp(0.1 * b[:, 0]))


@pytest.mark.parametrize("name", ["phantom2_fitted", "phantom2", "chicken"])
def test_the_valley_is_where_the_error_is_least(name: str) -> None:
    found = run(name, [-0.9, -0.1, 0.0, 0.8])
    assert found["ridge"] and found["others"] == [True, False, False, False]
    assert min(found["ms"]) < 300
    for batch, alone in found["alone"]:
        assert batch == pytest.approx(alone, abs=1e-6)
    rows = np.array(found["rows"], dtype=np.float64)
    assert found["alone"][0][0] == pytest.approx(0.0, abs=1e-6)  # of the needle's own parameters
    valley = [one for one in zip(found["valley"], found["between"], rows, strict=True) if one[0]]
    assert len(valley) > 5
    for _, error, row in valley:
        assert error <= np.nanmin(row) + 0.01
    assert found["contour"] and np.allclose(found["contour"], 0.2, atol=0.06)
    columns = np.array([one["column"] for one, *_ in valley])
    assert columns[0] > columns[-1]  # a stiffer layer needs less b


@pytest.mark.parametrize("name", sorted(path.stem for path in Path("configs/scenes").glob("*.toml")))
def test_an_s_is_offered_where_the_slope_changes_its_sign(name: str) -> None:
    found = run(name, [])
    slope = np.array(found["slope"])
    if found["turn"] is not None:
        assert slope.min() < 0 < slope.max()
    if name == "figure1":  # its base moves: the turn would not be all that differs
        assert found["turn"] is None
    if name == "phantom2_fitted":
        assert found["turn"] is not None
    best = found["stiffer"]
    assert best is None or (best["moved"] >= 0.05 * best["all"] and best["to"] > best["from"])
