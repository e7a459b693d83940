"""Where a steered needle lies in space: where the files of a run have it, and its log says so alone."""

import needles
import numpy as np
import pytest
from test_viewer_opening import run_study

from needlefit.datasets.read import read as read_dataset
from needlefit.geometry.frames import Placement
from needlefit.inference.likelihood.observations import select_points
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import compute_positions
from needlefit.planning.steered_needle import (
    Change,
    RecordedStep,
    Recording,
    SteeredNeedle,
    begin_replay,
    read_recording,
    replay,
    write_recording,
)
from needlefit.studies.needle_placement import NEEDLE_POINTS
from needlefit.viewer.opening import open_target

QUICK = "schema = 1\nstarts = 1\nevaluations = 10\ntolerance = 1e-3\n"
ID, DEPTH = "needle-3", needles.DEPTHS[2]
TURNED = "lps_to_world = [[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30]]"
"""A quarter turn about z: of LPS (x, y, z), the world is (10 - y, 20 + x, 30 + z)."""


def fitted(folder, pose, compared=None):
    """Fit needles whose scan is turned in the world; return what the run found."""
    source = "first_point" if pose == "direction" else "stage"
    file = needles.build(folder / "data" / "needles", pose_source=source)
    text = file.read_text().replace("[frame]", f"[frame]\n{TURNED}")
    if pose == "free":
        text = text.replace('pose = "known"', 'pose = "free"')
        text = text.replace("drop_proximal_mm = 0.0", "drop_proximal_mm = 2.0")
        text = text[: text.index("[media")] + f"[media.gel]\nboundaries_mm = [{needles.INTERFACE}]\n"
    file.write_text(text)
    return run_study(folder, QUICK, compared)


def steered(path):
    """Record how the needle of the run is inserted to its measured depth."""
    viewed_scene = open_target(f"reports/small/{ID}")
    steering = SteeredNeedle(Scene.from_record(viewed_scene.record), viewed_scene.first_cell)
    change = Change("depth_mm", None, DEPTH)
    steering.apply([change])
    step = RecordedStep(1, 0.5, (change,), steering.now.shape.tip_lateral)
    write_recording(Recording(viewed_scene.make_head(), (step,)), path)


@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize("pose", ["known", "direction", "free"])
def test_a_steered_needle_lies_where_the_files_of_a_run_have_it(pose, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = fitted(tmp_path, pose)
    compared = {"known": "world", "direction": "shifted", "free": "aligned"}[pose]
    assert {*results.frames["errors"]["comparison"]} == {compared}
    steered(tmp_path / "log.csv")
    recording = read_recording(tmp_path / "log.csv")
    placement, steering = Placement.from_record(recording.head.placement), begin_replay(recording)
    *_, end = replay(recording, steering)
    one = next(one for one in read_dataset(tmp_path / "data" / "needles").insertions if one.id == ID)
    s = select_points(*(("free", 2.0) if pose == "free" else ("known", 0.0)), one, NEEDLE_POINTS).s
    found = placement.to_patient(compute_positions(end.state.shape, s))
    rows = results.frames["needles"]
    rows = rows[rows["insertion"] == ID]
    np.testing.assert_allclose(
        found, rows.loc[rows["curve"] == "fitted", ["x_mm", "y_mm", "z_mm"]], rtol=0, atol=1e-6
    )
