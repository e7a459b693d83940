"""The kernel in WebAssembly through its JavaScript binding: the same bytes as the library's."""

import json
import re
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest
from mechanics_cases import random_needle, random_rules, random_tissue

from needlefit.mechanics import native
from needlefit.mechanics.batch import Batch, compute_batch_positions, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step, TrackedTip
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.packing import pack_layers
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.simulate import Loads, compute_loads
from needlefit.mechanics.tissue import Tissue

pytestmark = pytest.mark.skipif(
    shutil.which("node") is None or not (native.FOLDER / "kernel.wasm").is_file(),
    reason="no Node.js, or a system compiler has built no WebAssembly",
)

PROGRAM = """
import {readFileSync} from 'node:fs'
import {compile, Session, SessionBatch} from KERNEL
const job = JSON.parse(readFileSync(0, 'utf8'), (key, value) => value === 'NaN' ? NaN : value)
const kernel = await compile(readFileSync(WASM))
const hex = array => Buffer.from(array.buffer, array.byteOffset, array.byteLength).toString('hex')
const list = shape => Object.fromEntries(Object.entries(shape)
  .map(([name, value]) => [name, value instanceof Float64Array ? hex(value) : value]))
const found = []
if (job.steps) {
  for (const name of ['mu', 'law', 'strength']) job.values[name] = Float64Array.from(job.values[name])
  const batch = await SessionBatch.begin(kernel, job.model, job.values, 200)
  const good = job.steps.map(({depth, inputs}) => {
    batch.hold(inputs)
    return Array.from(job.values.strength, (_, i) => batch.go(i, depth))
  })
  found.push(...good.at(-1).map((one, i) => one && hex(batch.positions(i, Float64Array.from(job.s)))))
} else {
  const session = await Session.begin(kernel, job.model, job.begin)
  for (const {move, inputs} of job.moves) {
    const go = () => move < 0 ? session.retract(-move) : session.advance(move)
    const shape = move === undefined ? session.set(inputs) : go()
    const good = session.shape === shape
    found.push({...list(shape), loads: good ? list(session.forces()) : null,
      positions: good ? hex(session.positions([shape.x[0], 0, shape.depth / 3, shape.depth])) : null})
  }
}
console.log(JSON.stringify(found))
"""


def run_node(job: dict[str, Any]) -> list[dict[str, Any]]:
    program = PROGRAM.replace("KERNEL", repr((native.FOLDER / "needle.js").as_uri()))
    program = program.replace("WASM", repr(str(native.FOLDER / "kernel.wasm")))
    done = subprocess.run(
        ["node", "--input-type=module", "-e", program],
        input=json.dumps(job), capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout))


def to_hex(array: np.ndarray) -> str:
    return np.ascontiguousarray(array, dtype=np.float64).tobytes().hex()


def write_model(
    needle: Needle, tissue: Tissue, rules: ModelOptions, first_cell: float | None
) -> dict[str, Any]:
    sizes, arrays = pack_layers(tissue, 1, {})
    arrays |= {"boundaries": tissue.boundaries}
    layers = {name: array.ravel().tolist() for name, array in arrays.items()}
    return layers | {
        "length": needle.length, "rigidity": needle.flexural_rigidity, "terms": sizes["terms"],
        "spacing": rules.spacing, "element": rules.element, "firstCell": first_cell,
        "pathAngle": rules.path_angle, "switch": rules.switch, "tangent": rules.tangent,
    }  # fmt: skip


def write_inputs(bevel: Bevel, controls: Controls) -> dict[str, Any]:
    guides = [{"x": g.x, "y": g.y, "slope": g.slope} for g in controls.guides]
    tip = None if controls.tip is None else {"y": controls.tip.y, "slope": controls.tip.slope}
    base = {"y": controls.base_y, "slope": controls.base_slope, "stageSlope": controls.stage_slope}
    strength = bevel.cut_angle or bevel.offset
    return {"bevel": {"side": bevel.side, "strength": strength}, "base": base, "guides": guides, "tip": tip}


def write_shape(shape: NeedleShape) -> dict[str, Any]:
    return {
        "status": shape.status, "passes": shape.iterations, "depth": shape.depth, "x": to_hex(shape.x),
        "u": to_hex(shape.u), "slope": to_hex(shape.slope), "constraints": to_hex(shape.constraints.ravel()),
        "track": to_hex(shape.tip_track),
    }  # fmt: skip


def assert_same_loads(found: dict[str, Any], expected: Loads) -> None:
    for name in ("s", "weight", "load"):
        assert found[name] == to_hex(getattr(expected, name))
    supports = zip(
        [found["base"], *found["guides"], found["tip"]],
        [expected.base, *expected.guides, expected.tip],
        strict=True,
    )
    for one, other in supports:
        assert (one["x"], one["force"], one["moment"]) == (other.x, other.force, other.moment)
    assert found["tipRegionForce"] == pytest.approx(expected.tip_region_force, rel=1e-12)


def random_moves(rng: np.random.Generator, path_angle: bool) -> list[tuple[str, Any]]:
    moves: list[tuple[str, Any]] = []
    guides = (
        Guide(-5.3, 0.1, None),
        Guide(3.0, 0.05, in_tissue=True),
        Guide(12.25, 0.02, None, in_tissue=True),
    )
    for _ in range(40):
        kind = rng.integers(10)
        if kind < 5:
            moves.append(("go", float(rng.choice([1.0, 0.3, rng.uniform(0, 4)]))))
        elif kind == 5:
            moves.append(("go", -float(rng.choice([1.0, rng.uniform(0, 6)]))))
        elif kind == 6:
            strength = rng.uniform(0, 0.2) / (9 if path_angle else 1)
            bevel = (
                (0.0, int(rng.choice([-1, 1])), strength)
                if path_angle
                else (strength, int(rng.choice([-1, 1])))
            )
            moves.append(("bevel", Bevel(*bevel)))
        elif kind == 7:
            moves.append(("base", (rng.uniform(-0.5, 0.5), rng.uniform(-0.005, 0.005))))
        elif kind == 8:
            moves.append(("guides", tuple(guides[: rng.integers(4)])))
        else:
            moves.append(("tip", None if rng.random() < 0.5 else TrackedTip(rng.uniform(-0.1, 0.1), None)))
    return moves


@pytest.mark.parametrize("seed", range(6))
def test_a_session_in_javascript_is_the_session(seed: int) -> None:
    """Turns of the bevel, base moves, guides, tracked tips, retraction, insertion again, and all loads."""
    rng = np.random.default_rng(seed)
    path_angle = seed % 3 == 2
    rules = random_rules(rng)
    if path_angle:
        rules = ModelOptions(rules.spacing, rules.element, advance="path_angle")
    needle, tissue = random_needle(rng, rules), random_tissue(rng, rules, 0.3 * (seed % 2))
    bevel = Bevel(0.0, 1, 0.01) if path_angle else Bevel(0.1)
    session = Session(needle, tissue, bevel, 0.7 * rules.spacing, Controls(0.2), rules)
    model = write_model(needle, tissue, rules, session.lattice.first_cell)
    job = {"model": model, "begin": write_inputs(bevel, Controls(0.2)), "moves": []}
    expected: list[tuple[NeedleShape, NeedleShape, Controls]] = []
    for kind, value in random_moves(rng, path_angle):
        if kind == "go":
            move = max(value, -session.depth)
            shape = session.step(move)
            job["moves"].append({"move": move} if move else {"inputs": {}})
        else:
            shape = session.step(0.0, **{kind: value})
            inputs = write_inputs(session.last.bevel, session.last.controls)
            if not shape.converged:  # the inputs that failed are not the session's
                bevel = value if kind == "bevel" else session.last.bevel
                changed = {"base": {"base_y": value[0], "base_slope": value[1]}} if kind == "base" else {}
                controls = Controls(**{
                    **{n: getattr(session.last.controls, n) for n in
                       ("base_y", "base_slope", "stage_slope", "guides", "tip")},
                    **changed.get(kind, {kind: value} if kind != "bevel" else {}),
                })  # fmt: skip
                inputs = write_inputs(bevel, controls)
            job["moves"].append({"inputs": inputs})
        expected.append((shape, session.now.shape, session.last.controls))
    for found, (shape, now, controls) in zip(run_node(job), expected, strict=True):
        loads, positions = found.pop("loads"), found.pop("positions")
        passes = write_shape(shape) | ({} if shape.iterations else {"passes": found["passes"]})
        if shape.converged:
            assert found == passes
            s = np.array([now.x[0], 0.0, now.depth / 3, now.depth])
            assert positions == to_hex(compute_positions(now, s))
            assert_same_loads(loads, compute_loads(now, tissue, needle, controls, rules))
        else:
            assert found["status"] == shape.status


def test_a_session_makes_room_for_more_turns_than_it_has_cells() -> None:
    needle, tissue = Needle(12.0, 2e4), Tissue([0.5], [1.0])
    session = Session(needle, tissue, Bevel(0.1))
    moves: list[dict[str, Any]] = []
    for turn in range(40):
        session.step(0.1, bevel=Bevel(0.1, (-1) ** turn))
        moves += [{"inputs": {"bevel": {"side": (-1) ** turn}}}, {"move": 0.1}]
    begin = write_inputs(Bevel(0.1), Controls())
    model = write_model(needle, tissue, session.rules, 1.0)
    found = run_node({"model": model, "begin": begin, "moves": moves})[-1]
    assert {name: found[name] for name in write_shape(session.now.shape)} == write_shape(session.now.shape)


def test_needles_that_go_on_side_by_side_are_those_of_a_batch() -> None:
    """140 mm and 200 sets: the memory of the module grows."""
    rng = np.random.default_rng(0)
    needle, tissue = Needle.from_tube(200.0, 1.27, 80e3), Tissue([0.2, 33.0], [1.0, -1.0], [70.0])
    controls = Controls(0.1, guides=(Guide(-12.0, 0.05),))
    steps = (
        Step(60.0, Bevel(0.08), controls),
        Step(40.0, Bevel(0.08, -1), controls),
        Step(140.0, Bevel(0.05), controls),
    )
    mu, offset = 10 ** rng.uniform(-1, 1, (200, 2)), rng.uniform(0, 0.1, 200)
    batch = Batch(needle, tissue, steps, mu=mu, offset=offset)
    (shapes,) = simulate_batches([batch])
    s = [-3.0, 0.0, 33.3, 140.0]
    law = np.tile(pack_layers(tissue, 1, {})[1]["law"].ravel(), 200)
    found = run_node({
        "model": write_model(needle, tissue, batch.rules, 1.0), "s": s,
        "steps": [{"depth": step.depth, "inputs": write_inputs(step.bevel, step.controls)} for step in steps],
        "values": {
            "sets": 200, "mu": mu.ravel().tolist(), "law": law.tolist(), "strength": offset.tolist()
        },
    })  # fmt: skip
    positions = compute_batch_positions(shapes, np.array(s))
    assert shapes.converged.all()
    assert found == [to_hex(one) for one in positions]


def test_the_module_refuses_what_the_library_refuses() -> None:
    model = write_model(Needle.from_tube(150.0, 1.27, 80e3), Tissue([0.2], [1.0]), ModelOptions(), 1.0)
    for wrong in ({"element": 0.3}, {"mu": [1.0, 2.0]}, {"spacing": -1.0}, {"law": [1.0]}):
        with pytest.raises(AssertionError, match=r"TypeError|RangeError"):
            run_node({"model": model | wrong, "begin": {}, "moves": []})


def test_the_binding_reads_no_files_and_imports_only_its_own() -> None:
    for name in ("needle.js", "memory.js"):
        text = (native.FOLDER / name).read_text(encoding="utf-8")
        assert set(re.findall(r'from "([^"]+)"', text)) <= {"./memory.js"}
        assert not any(word in text for word in ("require(", "fetch(", "import("))
