"""The address of a needle and its recording, run in Node.js: either leads to the same bits, or is refused."""

import numpy as np
import pytest
from page_files import run_node
from test_page_model import SCENES, pytestmark, random_orders  # noqa: F401 - a mark of this module, too

from needlefit.mechanics.shape import list_planes
from needlefit.planning.steered_needle import (
    SteeredNeedle,
    begin_replay,
    format_head,
    make_steered_scene,
    read_recording,
    replay,
)
from needlefit.viewer.page_needle import encode_scene

PROGRAM = """
import {readFileSync} from 'node:fs'
import {compile} from KERNEL
const load = (name) => import(PAGE + name)
const [{SteeredNeedle}, address] = await Promise.all(['model/steered.js', 'address.js'].map(load))
const {scene, head, paths, wrong} = JSON.parse(readFileSync(0, 'utf8'))
const kernel = await compile(readFileSync(WASM))
const toHex = (array) => Buffer.from(array.buffer, array.byteOffset, array.byteLength).toString('hex')
const hex = ({session: {shape: {x, u, slope, constraints}}}) => [x, u, slope, constraints].map(toHex)
const attempt = (work) => {
  try { return work() } catch (error) { if (!error.expected) throw error; return error.what }
}
const found = []
for (const path of paths) {
  const steered = await SteeredNeedle.begin(kernel, scene)
  for (const changes of path) attempt(() => steered.apply(changes))
  const [recorded, recording] = [hex(steered), address.writeRecording(head, steered)]
  const written = await address.writeAddress(kernel, steered)
  const reopened = await SteeredNeedle.begin(kernel, scene)
  const before = steered.tipLateral
  for (const one of written ? [steered, reopened] : []) { // the page shows what it copies
    for (const changes of address.readAddress(written, scene)) one.apply(changes)
  }
  const moved = Math.abs(steered.tipLateral - before)
  const bits = {recorded, shown: hex(steered), reopened: hex(reopened)}
  found.push({...bits, recording, written, moved})
}
const refused = wrong.map((one) => attempt(() => address.readAddress(one, scene)))
console.log(JSON.stringify({found, refused}))
"""
LINKED, MIXED = "bits of the address", "all inputs"
CARRIED = {
    "depth_mm",
    "bevel_roll_deg",
    "bevel_side",
    "mu_pa",
    "offset_throughout_mm",
    "cut_angle_throughout_deg",
}
WRONG = (
    "foo=1", "depth=-5", "depth=50&turn=60", "depth=50&turn=30,20", "depth=50&turn=0", "depth=x",
    "depth=50&roll=", "depth=50&mu9=1", "depth=50&base_y=1", "b=0.1", "depth=50&turn=20:x",
)  # fmt: skip


def draw_path(rng, scene, kind):
    """Return changes of a hand, all of them or those that an address carries, and at last a deeper needle."""
    path = [order["changes"] for order in random_orders(rng, scene, 20)]
    if kind == LINKED:
        path = [changes for changes in path if {name for name, *_ in changes} <= CARRIED]
    deepest = max(change[2] for changes in path for change in changes if change[0] == "depth_mm")
    return [*path, [["depth_mm", None, deepest + 5.0]]]


@pytest.mark.parametrize("kind", [LINKED, MIXED])
@pytest.mark.parametrize("name", ["measured", "two terms", "path angle", "rolled"])
def test_random_paths_reopen_to_the_bit_or_are_refused(name, kind, tmp_path):
    viewed = SCENES[name]()
    scene = make_steered_scene(viewed.record, name)
    rng = np.random.default_rng(79)
    paths = [draw_path(rng, scene, kind) for _ in range(20)]
    encoded = encode_scene(viewed, SteeredNeedle(scene, viewed.first_cell))
    job = {"scene": encoded, "head": format_head(viewed.make_head()), "paths": paths, "wrong": WRONG}
    done = run_node(PROGRAM, job)
    linked = 0
    for number, found in enumerate(done["found"]):
        if found["written"]:
            linked += 1
            assert found["reopened"] == found["shown"], found["written"]
            assert found["moved"] < 1e-6  # mm: within the tolerance of the solver
        file = tmp_path / f"{number}.csv"
        file.write_text(found["recording"], "utf-8")
        recording = read_recording(file)
        steering = begin_replay(recording)
        assert max(step.tip_offset_mm for step in replay(recording, steering)) == 0
        shape = steering.now.shape
        u, slope = list_planes(shape)
        parts = (shape.x, u, slope, shape.constraints[:, : 1 + len(u)])
        assert found["recorded"] == [np.ascontiguousarray(one).tobytes().hex() for one in parts]
    assert linked >= 15 if kind == LINKED else linked < 10  # the way back past a turn is in no address
    assert all(isinstance(one, str) and one for one in done["refused"])
