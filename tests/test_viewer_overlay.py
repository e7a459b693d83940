"""What lies over the needle, against what is known of it: errors, bands, and a scan made for it."""

import dataclasses
import io
import json
import math
import shutil
import subprocess
from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from inference_cases import TRUTH, dataset, insertion, measure, medium
from scipy.spatial import cKDTree

from needlefit.datasets.sources import ScanVolume, find_volume, write_volumes
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length, compare_curves
from needlefit.geometry.frames import Frame, align_rigid, make_entry_frame
from needlefit.imaging.volume import Volume, to_patient
from needlefit.imaging.volume_files import write_volume
from needlefit.inference.compared_points import compare_points
from needlefit.inference.forward_model import ParameterDraws, make_scene_record, predict, select_layer_draws
from needlefit.mechanics.control import Guide
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.mechanics.tissue import Tissue
from needlefit.planning.steering import StartedInsertion
from needlefit.viewer.export import PAGE
from needlefit.viewer.messages import encode_measured
from needlefit.viewer.overlays import (
    InsertionScan,
    compute_band,
    find_scan,
    make_measured_overlay,
    read_slice,
)

PLAN = insertion(40.0, [17.5], (1, 2))
MEASURED = measure(TRUTH, medium(), PLAN)
OFF = {**TRUTH, "mu1_pa": 2e5, "bevel_mm": 0.1}


def straight(depth: float, status: str = "converged") -> NeedleShape:
    x, none = np.array([depth - 150.0, depth]), np.zeros(2)
    return NeedleShape(x, none, none, np.zeros((1, 2)), np.zeros((1, 2)), status, 0)  # type: ignore[arg-type]


def oblique(angle: float, depth: float = 40.0):
    """A measured needle that runs straight at an angle to the entry axis."""
    s = np.linspace(0, depth, 9)
    planar = s[:, None] * [math.cos(angle), math.sin(angle)]
    return dataclasses.replace(insertion(depth), planar=planar)


def of(one, pose="known", floor=0.2, shape=None, drop=0.0):
    return make_measured_overlay(
        dataset([one], pose=pose, drop=drop), one, floor, shape or straight(one.depth)
    )


ERRORS = """
import {readFileSync} from 'node:fs'
const {computeErrors} = await import(MODULE)
const {measured, depths} = JSON.parse(readFileSync(0, 'utf8'))
const positions = (s) => s.flatMap((one) => [one, 0])
const straight = (depth) => ({shape: {x: [depth - 150, depth], depth}, positions})
console.log(JSON.stringify(depths.map((depth) => computeErrors(straight(depth), measured))))
"""


def page_errors(overlay, *depths: float) -> list[dict | None]:
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
        assert found["te_mm"] == pytest.approx(chord) and found["ipe_max_mm"] == pytest.approx(chord)
        assert found["ipe_mean_mm"] == pytest.approx(chord / 2)
        assert found["edp_percent"] == pytest.approx(100 * chord / (upto * math.sin(angle)))
        assert (found["upto_mm"], found["whole"]) == (upto, depth == 40.0)


@needs_node
def test_a_shape_of_unknown_pose_lies_on_the_needle_and_is_compared_where_it_is_whole():
    turned = MEASURED.planar @ [[0.0, 1.0], [-1.0, 0.0]] + [30.0, -4.0]
    free = dataclasses.replace(MEASURED, planar=turned)
    shape = predict(OFF, medium(), dataset([free]).needle, free)
    one = of(free, "free", shape=shape, drop=5.0)
    flat = straight(40.0)
    expected = compare_curves(*compare_points("free", 5.0, free, lambda s: compute_positions(flat, s)))
    part, whole = page_errors(one, 30.0, 40.0)
    assert part is None and whole["te_mm"] == pytest.approx(expected.tip_error)
    onto = compute_positions(shape, one.s)
    assert np.linalg.norm(one.points - onto, axis=1).max() < 0.3  # from 30 mm away
    np.testing.assert_allclose(align_rigid(one.points, onto), one.points, atol=1e-9)
    assert arc_length(one.points)[-1] == pytest.approx(35.0, abs=0.05)


SCENE = Scene.from_record(make_scene_record(TRUTH, medium(), dataset([PLAN]), PLAN))


def spread(count: int = 60) -> ParameterDraws:
    rng = np.random.default_rng(3)
    factors = np.exp(0.2 * rng.normal(size=(count, 3)))
    names = ["mu1_pa", "mu2_pa", "bevel_mm"]
    draws = {name: TRUTH[name] * factors[:, n] for n, name in enumerate(names)}
    alphas = {f"alpha{n}": rng.uniform(-30.0, 30.0, count) for n in (1, 2)}  # so far that they tell
    return select_layer_draws(pd.DataFrame(draws | alphas), (1, 2), "ogden")


def led() -> Session:
    """A needle as a hand leads it: the bevel flips, the base moves, a guide is set."""
    first = SCENE.steps[0]
    session = Session(SCENE.needle, SCENE.tissue, first.bevel, 0.7, rules=SCENE.rules)
    session.step(15.0)
    session.step(10.0, bevel=dataclasses.replace(first.bevel, side=-1, offset=0.02))
    session.step(-3.0, base=(0.8, 0.01))
    session.step(5.0, guides=(Guide(-20.0, 0.3, 0.0),))
    return session


def band(draws: ParameterDraws, path, first_cell: float = 1.0):
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
    np.testing.assert_allclose(found.low, low, atol=1e-6)
    np.testing.assert_allclose(found.high, high, atol=1e-6)
    np.testing.assert_allclose(found.x, np.median(x, axis=0), atol=1e-6)
    assert found.failed == 0 and np.all(np.diff(found.high - found.low)[-10:] > 0)  # widest at the tip


def bent(s: np.ndarray) -> np.ndarray:
    """The planar needle of the scan."""
    return np.column_stack([s, 0.004 * s**2])


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory):
    """An insertion, and the volume in which it was seen: bright along the needle, turned in the world."""
    frame = make_entry_frame(np.array([5.0, -3.0, 8.0]), np.array([0.8, 0.6, 0.0]), np.array([0.0, 0.3, 1.0]))
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    patient = Frame(np.array([40.0, -20.0, 11.0]), turn)
    flat = bent(np.linspace(0.0, 30.0, 61))
    centerline = frame.to_world(np.column_stack([flat, np.zeros(len(flat))]))
    one = dataclasses.replace(
        insertion(30.0), frame=frame, patient=patient, centerline=centerline, planar=flat
    )
    around = patient.to_local(centerline)
    low, high = around.min(axis=0) - 12.0, around.max(axis=0) + 12.0
    size = np.ceil((high - low) / 0.8).astype(int)
    volume = Volume(np.zeros(size[::-1], dtype=np.float32), low, np.full(3, 0.8), np.eye(3))
    dense = bent(np.linspace(-8.0, 30.0, 400))
    dense[dense[:, 0] < 0, 1] = 0.0  # straight before the entry
    axis = patient.to_local(frame.to_world(np.column_stack([dense, np.zeros(len(dense))])))
    voxels = to_patient(volume, np.argwhere(np.ones(size)))
    near = cKDTree(axis).query(voxels, distance_upper_bound=4.0)[0]
    bright = 40.0 + 2500.0 * np.exp(-0.5 * (near / 0.7) ** 2)
    values = np.ascontiguousarray(bright.reshape(size).T.astype(np.float32))
    volume = dataclasses.replace(volume, values=values)
    path = tmp_path_factory.mktemp("scan") / "one.nrrd"
    write_volume(volume, path)
    return InsertionScan(ScanVolume(path), one)


def test_the_needle_lies_on_its_shadow_in_the_slice(scan):
    png, (left, right, bottom, top) = read_slice(scan)
    picture = matplotlib.image.imread(io.BytesIO(png))  # the top row first
    height, width = picture.shape[:2]
    columns = left + (np.arange(width) + 0.5) * (right - left) / width
    rows = top - (np.arange(height) + 0.5) * (top - bottom) / height
    needle = np.where(picture[..., 3] > 0, np.maximum(picture[..., 0] - 0.6, 0.0), 0.0)  # what is bright
    for x in (2.0, 10.0, 18.0, 27.0):
        column = needle[:, np.argmin(np.abs(columns - x))]
        middle = np.sum(rows * column) / np.sum(column)
        assert middle == pytest.approx(bent(np.array([x]))[0, 1], abs=0.1)
    assert picture[0, 0, 3] == 0.0  # clear outside of the volume
    assert top - bottom == pytest.approx(50.0 + 3.6, abs=0.7)


def test_a_dataset_locates_its_scans_and_missing_ones_are_reported(scan, tmp_path, monkeypatch):
    whole = dataclasses.replace(dataset([scan.insertion]), path=tmp_path / "dataset.toml")
    assert find_scan(whole, scan.insertion) == (None, "")  # nothing was promised
    write_volumes(tmp_path, {"other": ScanVolume(Path("x")), scan.insertion.id: scan.volume})
    found, lacking = find_scan(whole, scan.insertion)
    assert lacking == "" and found.volume == ScanVolume(scan.volume.path.resolve())
    monkeypatch.setattr("needlefit.viewer.overlays.ct_packages_installed", lambda: False)
    assert "needlefit[ct]" in find_scan(whole, scan.insertion)[1]
    monkeypatch.undo()
    (tmp_path / "volumes.csv").write_text(f"id,volume,series\n{scan.insertion.id},scans/a,2\n")
    assert find_volume(whole, scan.insertion.id) == ScanVolume(tmp_path / "scans/a", "2")
    found, lacking = find_scan(whole, scan.insertion)
    assert found is None and f"not at {tmp_path / 'scans/a'} any more" in lacking
    (tmp_path / "volumes.csv").write_text("id,file\na,b\n")
    with pytest.raises(DataError, match="volume"):
        find_volume(whole, "a")
