"""What scenes of the page show, run in Node.js: an S, where force goes, where b and a modulus fit alike."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_files import PAGE
from test_page_model import pytestmark  # noqa: F401 - a mark of this module, too

from needlefit.mechanics import native
from needlefit.planning.steered_needle import SteeredNeedle, make_steered_scene
from needlefit.viewer.opening import open_target
from needlefit.viewer.page_needle import encode_scene

PROGRAM = """
import {readFileSync} from 'node:fs'
import {compile} from KERNEL
const load = (name) => import(PAGE + name + '.js')
const [{SteeredNeedle}, {listSteps}, probes] = await Promise.all(['steered', 'inputs', 'probes'].map(load))
const scene = JSON.parse(readFileSync(0, 'utf8'))
const kernel = await compile(readFileSync(WASM))
const begin = async () => {
  const needle = await SteeredNeedle.begin(kernel, scene)
  for (const changes of listSteps(scene)) needle.apply(changes, {validOnly: false})
  return needle
}
const turn = probes.findTurn(await begin())
const turned = await begin()
for (const changes of probes.listTurned(turn ?? 1, scene)) turned.apply(changes, {validOnly: false})
const {x, u} = turned.session.shape
const inserted = (values) => [...values].filter((_, i) => x[i] >= 0)
const stiffer = probes.findStiffer(await begin())
console.log(JSON.stringify({turn, x: inserted(x), y: inserted(u.subarray(0, x.length)), stiffer}))
"""


def run(name: str) -> Any:
    viewed = open_target(name, first="scene")
    scene = make_steered_scene(viewed.record, name)
    program = PROGRAM.replace("KERNEL", repr((native.FOLDER / "needle.js").as_uri()))
    program = program.replace("PAGE", repr((PAGE / "model").as_uri() + "/"))
    program = program.replace("WASM", repr(str(native.FOLDER / "kernel.wasm")))
    command = ["node", "--no-wasm-tier-up", "--input-type=module", "-e", program]
    job = json.dumps(encode_scene(viewed, SteeredNeedle(scene, viewed.first_cell)))
    done = subprocess.run(command, input=job, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


NOISE_MM = 0.1


@pytest.mark.parametrize("name", sorted(path.stem for path in Path("configs/scenes").glob("*.toml")))
def test_scenes_are_offered_where_the_needle_shows_them(name: str) -> None:
    """An S bends by more than noise; forces move between two layers at least, within the model's limits."""
    found = run(name)
    y = np.array(found["y"])
    if found["turn"] is not None:
        away = y - np.interp(found["x"], [found["x"][0], found["x"][-1]], [y[0], y[-1]])
        assert min(away.max(), -away.min()) > NOISE_MM  # to both sides of the line from entry to tip
    if name == "figure1":  # its base moves: the turn would not be all that differs
        assert found["turn"] is None
    if name == "phantom2_fitted":
        assert found["turn"] is not None
    best = found["stiffer"]
    assert best is None or (best["moved"] >= 0.05 * best["all"] and best["to"] > best["from"])
    if best is not None:
        assert best["valid"] and sum(force > 0 for force in best["before"]) >= 2


def test_a_scene_of_one_layer_has_no_force_to_move(tmp_path) -> None:
    text = Path("configs/scenes/phantom2.toml").read_text("utf-8")
    scene = tmp_path / "one.toml"
    scene.write_text("[[layers]]".join(text.split("[[layers]]")[:2]), "utf-8")
    assert run(str(scene))["stiffer"] is None
