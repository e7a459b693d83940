"""The twin as scans: what is true stands in the volumes at its stated position."""

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import map_coordinates
from typer.testing import CliRunner

from needlefit.cli.application import build as application
from needlefit.cli.exit_codes import Invocation
from needlefit.errors import ConfigError
from needlefit.imaging.registration.pairing import find_symmetries
from needlefit.imaging.volume import to_index, to_patient
from needlefit.imaging.volume_files import read_volume
from needlefit.project.locate import shipped_folder
from needlefit.project.tasks import THIS_PROCESS, LocalPool, run_in_order
from needlefit.project.toml import load
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.synthetic import design
from needlefit.synthetic.design import list_planned_insertions, select_planned_insertions
from needlefit.synthetic.insertion import TWIN_SEED, simulate_insertion
from needlefit.synthetic.scans import (
    SAMPLE_SETUP,
    WHOLE_BOX_SETUP,
    acquire,
    expose,
    measure_markers,
    render_insertion,
    sample_whole_needle,
    write_scans,
)

SHIPPED = shipped_folder() / "data" / "sample_scan"
PLAN = {planned.id: planned for planned in list_planned_insertions()}
TABLED = replace(SAMPLE_SETUP, low=np.array([0.0, -16.0, -44.0]), high=np.array([30.0, 4.0, 11.0]))


def quiet(_what, _done, _of):
    """Report nothing."""


def crop(name, seed=1, setup=SAMPLE_SETUP, **scanner):
    """An insertion, its exposure and its volume, in a small field around the sample's needle."""
    twin = simulate_insertion(select_planned_insertions([name])[0], seed)
    exposure = expose(twin, setup, seed)
    exposure = replace(exposure, scanner=replace(exposure.scanner, **scanner))
    return twin, exposure, acquire(exposure, seed, name)


CLEAN = {"noise_hu": 0.0, "streaks": 0.0, "bloom": 0.0, "cupping_hu": 0.0}


@pytest.fixture(scope="module")
def clean():
    return crop("sample", **CLEAN)


def brightness(volume, points):
    """The volume (N,) at patient points (N, 3), linearly between voxels."""
    return map_coordinates(volume.values, to_index(volume, points)[:, ::-1].T, order=1, cval=np.nan)


def world_points(x, y, z):
    return np.column_stack(np.broadcast_arrays(np.asarray(x, dtype=float), y, z))


# ---- what is in a volume


def test_the_needle_is_at_its_true_position(clean):
    """The centre of brightness across the true axis is the axis, from the air to the tip."""
    twin, exposure, volume = clean
    frame = twin.true_insertion.frame
    true = sample_whole_needle(twin)
    inside = np.flatnonzero((frame.to_local(true)[:, 0] > -10) & (frame.to_local(true)[:, 0] < 22))[::8]
    steps = np.linspace(-2.5, 2.5, 41)
    a, b = np.meshgrid(steps, steps)
    for n in inside:
        across = frame.rotation[:, 1] * a.reshape(-1, 1) + frame.rotation[:, 2] * b.reshape(-1, 1)
        bright = brightness(volume, exposure.scene.box.to_world(true[n] + across))
        weight = np.clip(bright - 1000, 0, None)
        assert np.linalg.norm(weight @ across / weight.sum()) < 0.06
    ends = exposure.scene.box.to_world(true[-1] + np.outer([-1.5, 1.5], true[-1] - true[-2]) / 0.25)
    assert brightness(volume, ends)[0] > 2000 and brightness(volume, ends)[1] < 500


def test_the_needle_is_held_by_its_stage_and_its_bevel_looks_where_it_steers():
    twin = simulate_insertion(PLAN["phantom2-02"], 1)
    true, frame = sample_whole_needle(twin), twin.true_insertion.frame
    assert np.linalg.norm(np.diff(true, axis=0), axis=1).sum() == pytest.approx(150.0, abs=0.05)
    base = frame.to_local(true[:2])
    assert_allclose(base[0], [twin.planned.depth - 150.0, 0, 0], atol=1e-9)
    assert_allclose(base[1, 1:], 0, atol=1e-3)  # clamped along the stage's axis
    assert_allclose(true[-1], twin.true_insertion.centerline[-1], atol=1e-9)
    twin = simulate_insertion(PLAN["phantom2-08"], 1)
    needle = expose(twin, WHOLE_BOX_SETUP, 1).scene.needles[0]
    world = expose(twin, WHOLE_BOX_SETUP, 1).scene.box
    toward = world.rotation.T @ needle.bevel_toward
    bent = twin.true_insertion.centerline[-1] - twin.true_insertion.centerline[0]
    assert toward @ bent > 0
    assert toward @ twin.planned.toward == pytest.approx(np.cos(twin.deviations.roll), abs=1e-3)


def test_layers_face_and_balls_show_at_their_true_places(clean):
    # Half-way in HU lies the true interface, which is not the stated one.
    twin, exposure, volume = clean
    true = twin.specimen.phantom.interfaces[0]
    assert 0.02 < abs(true - 19.0) < 0.4
    x = np.linspace(14, 24, 400)
    profile = np.mean(
        [
            brightness(volume, exposure.scene.box.to_world(world_points(x, y, z)))
            for y in (8.0, 9.0, 10.0)
            for z in (-9.0, -8.0, 7.0)
        ],
        axis=0,
    )
    assert_allclose(profile[[0, -1]], [20.0, 90.0], atol=1.0)
    assert np.interp(55.0, profile, x) == pytest.approx(true, abs=0.03)
    _, exposure, volume = clean
    x = np.linspace(-3, 3, 200)
    profile = brightness(volume, exposure.scene.box.to_world(world_points(x, 10.0, -10.0)))
    assert np.interp(-490.0, profile, x) == pytest.approx(0.0, abs=0.03)
    for center in exposure.scene.box.to_world(SAMPLE_SETUP.markers):
        voxels = np.argwhere(volume.values > 700)[:, ::-1]
        places = to_patient(volume, voxels)
        near = np.linalg.norm(places - center, axis=1) < 2.5
        assert_allclose(places[near].mean(axis=0), center, atol=0.06)
    off = np.concatenate(
        [(measure_markers(SAMPLE_SETUP, 1, str(n)) - SAMPLE_SETUP.markers).ravel() for n in range(200)]
    )
    assert off.std() == pytest.approx(0.1, rel=0.05) and abs(off.mean()) < 0.01


def test_the_cylinder_the_chicken_and_the_table_show_at_their_true_places():
    top = simulate_insertion(PLAN["phantom2-01"], 1).specimen.phantom.cylinder.top
    around = replace(
        WHOLE_BOX_SETUP, low=np.array([36.0, -16, -3]), high=np.array([48.0, -8, 3]), outside=-38.0
    )
    _, exposure, volume = crop("phantom2-01", setup=around, **CLEAN)
    x = np.linspace(36, 44, 300)
    world = exposure.scene.box.to_world
    profile = np.mean([brightness(volume, world(world_points(x, y, 0))) for y in (-14, -13, -12)], axis=0)
    assert_allclose(profile[[0, -1]], [35.0, 105.0], atol=1.0)
    assert abs(top - 40.0) > 0.02
    assert np.interp(70.0, profile, x) == pytest.approx(top, abs=0.03)
    twin, exposure, volume = crop(
        "chicken-02", setup=replace(SAMPLE_SETUP, markers=WHOLE_BOX_SETUP.markers), **CLEAN
    )
    values = brightness(volume, exposure.scene.box.to_world(world_points(np.arange(2.0, 28), -8.0, 8.0)))
    assert twin.specimen.phantom.boundaries == 0
    assert_allclose(values, 55.0, atol=0.5)
    _, exposure, volume = crop("sample", setup=TABLED, **CLEAN)
    down = brightness(volume, exposure.scene.box.to_world(world_points(10.0, -12.0, [-38.0, -42.0])))
    assert_allclose(down, [20.0, -100.0], atol=1.0)


# ---- pose, seed, files


def test_the_pose_is_arbitrary_about_the_long_axis_and_moderate_otherwise():
    twin = simulate_insertion(design.SAMPLE_INSERTION, 1)
    worlds = [
        expose(replace(twin, planned=replace(twin.planned, id=f"n{n}")), SAMPLE_SETUP, 1).scene.box
        for n in range(40)
    ]
    along = np.array([world.rotation[:, 0] for world in worlds])  # the box's depth, in the patient
    up = np.array([world.rotation[:, 2] for world in worlds])
    assert np.all(along[:, 2] > np.cos(np.deg2rad(9)))
    turns = np.rad2deg(np.arctan2(up[:, 1], up[:, 0]))
    assert np.all(np.histogram(turns, bins=4, range=(-180, 180))[0] > 3)
    assert np.ptp([world.origin for world in worlds], axis=0).min() > 200
    assert all(np.linalg.det(world.rotation) == pytest.approx(1) for world in worlds)


@pytest.mark.parametrize("name", ["phantom1-09", "phantom2-13", "chicken-12"])
def test_the_field_holds_box_markers_and_shaft_and_little_else(name):
    twin = simulate_insertion(PLAN[name], 1)
    exposure = expose(twin, WHOLE_BOX_SETUP, 1)
    grid, world = exposure.scanner.grid, exposure.scene.box
    corners = np.array([[x, y, z] for x in (0, 80) for y in (-40, 40) for z in (-40, 40)], dtype=float)
    shaft = twin.true_insertion.frame.to_world([[-34.0, 0, 0]])
    points = world.to_world(np.vstack([corners, WHOLE_BOX_SETUP.markers, shaft]))
    index = (points - grid.origin) @ grid.direction / grid.spacing
    assert np.all(index >= 0) and np.all(index <= np.array(grid.size) - 1)
    assert_array_equal(grid.spacing, 0.46)
    assert np.prod(grid.size) < 14e6


@pytest.mark.sweep
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path):
    paths = [tmp_path / name for name in "abc"]
    for path, seed in zip(paths, (1, 1, 2), strict=True):
        write_scans(path, [design.SAMPLE_INSERTION], seed, "nrrd", THIS_PROCESS, quiet)
    first, again, other = ({p.relative_to(d): p.read_bytes() for p in files(d)} for d in paths)
    assert first == again and first.keys() == other.keys()
    changed = {name.as_posix() for name in first if first[name] != other[name]}
    assert changed == {"volumes/sample.nrrd", "markers/sample.csv"}


def files(folder):
    return sorted(path for path in Path(folder).rglob("*") if path.is_file())


@pytest.mark.sweep
def test_the_shipped_sample_is_a_rebuild(tmp_path):
    """On the machine that built it to the last byte; elsewhere rounding may turn a voxel by 1 HU."""
    write_scans(tmp_path, [design.SAMPLE_INSERTION], TWIN_SEED, "nrrd", THIS_PROCESS, quiet)
    ours = [path.relative_to(SHIPPED) for path in files(SHIPPED) if path.name != "needlefit.json"]
    assert ours == [path.relative_to(tmp_path) for path in files(tmp_path)]
    assert sum((SHIPPED / name).stat().st_size for name in ours) < 2_000_000
    for name in ours:
        if name.suffix == ".nrrd":
            a, b = read_volume(SHIPPED / name), read_volume(tmp_path / name)
            assert np.abs(a.values - b.values).max() <= 1 and np.mean(a.values != b.values) < 1e-4
            assert_allclose(a.origin, b.origin, atol=1e-9)
        else:
            assert (SHIPPED / name).read_bytes() == (tmp_path / name).read_bytes()


@pytest.mark.sweep
def test_nrrd_and_dicom_hold_the_same_voxels(tmp_path):
    nrrd, dicom = (
        read_volume(render_insertion(tmp_path, design.SAMPLE_INSERTION, 1, form).scan.volume)
        for form in ("nrrd", "dicom")
    )
    assert_array_equal(nrrd.values, dicom.values)
    assert_allclose(nrrd.origin, dicom.origin, atol=1e-6)
    assert_allclose(nrrd.direction, dicom.direction, atol=1e-9)
    header = (tmp_path / "volumes" / "sample.nrrd").read_bytes()[:2000]
    assert b"Synthetic: needlefit twin ct sample --seed 1" in header


@pytest.mark.sweep
def test_scans_csv_states_the_plan_and_not_the_truth(tmp_path):
    table = write_scans(
        tmp_path, [PLAN["chicken-07"], design.SAMPLE_INSERTION], 1, "nrrd", THIS_PROCESS, quiet
    )
    with table.open(newline="") as file:
        chicken, sample = csv.DictReader(file)
    assert sample["id"] == "sample" and sample["scan"] == "volumes/sample.nrrd"
    assert sample["surfaces"] == (
        "layers/phantom2_interface1.stl=sheet:2;layers/phantom2_interface2.stl=sheet:3;"
        "layers/phantom2_cylinder.stl=solid:4"
    )
    assert (sample["layers"], sample["layers_alternative"], sample["origin"]) == ("2", "2", "synthetic")
    assert [float(sample[f"entry_{axis}_mm"]) for axis in "xyz"] == [0, 2.5, -3]
    assert (sample["pose_shift_sd_mm"], sample["pose_angle_sd_deg"]) == ("0.0500", "0.0500")
    assert chicken["surfaces"] == chicken["surfaces_in"] == ""
    assert chicken["specimen"] == "chicken-piece3" and chicken["bevel_side"] == "-1"
    assert [float(chicken[f"bevel_{axis}"]) for axis in "xyz"] == [-0.173648, 0.984808, 0]  # tilt 10, to +y
    for row in (chicken, sample):
        for name in [row["scan"], row["markers"], *filter(None, row["surfaces"].split(";"))]:
            assert (tmp_path / name.partition("=")[0]).is_file()
    recipe = load(tmp_path / "recipe.toml", ReconstructionRecord)
    assert recipe.markers.reference_sd_mm == WHOLE_BOX_SETUP.known_sd


# ---- markers


def test_the_layout_of_the_markers_has_no_symmetry_and_keeps_off_every_needle():
    for setup in [WHOLE_BOX_SETUP, SAMPLE_SETUP]:
        assert len(find_symmetries(setup.markers, np.hypot(setup.known_sd, 0.05))) == 1
    for planned in PLAN.values():
        line = planned.origin + np.linspace(-60, planned.depth, 300)[:, None] * planned.direction
        assert np.linalg.norm(line[:, None] - WHOLE_BOX_SETUP.markers, axis=2).min() > 20
    with pytest.raises(ConfigError, match=r"phantom2-9`\n.*phantom2-09, "):
        select_planned_insertions(["phantom2-9"])
    assert (
        select_planned_insertions(()) == list_planned_insertions()
        and len(select_planned_insertions(["sample", "sample"])) == 1
    )


# ---- the command


def needlefit(*words):
    return CliRunner().invoke(application(), ["twin", "ct", *map(str, words)], obj=Invocation(words))


@pytest.mark.sweep
def test_scans_replace_scans_and_nothing_else(tmp_path):
    out = tmp_path / "scans"
    assert needlefit("sample", "--out", out, "-q", "--jobs", 1).stdout.startswith(f"{out}: 1 synthetic scan")
    assert needlefit("sample", "--out", out, "-q", "--format", "dicom").exit_code == 0
    assert len(files(out / "volumes" / "sample")) > 50 and not (out / "volumes" / "sample.nrrd").exists()
    (out / "volumes" / "sample" / "mine.txt").touch()
    before = files(out)
    refused = needlefit("sample", "--out", out, "-q")
    assert refused.exit_code == 3 and files(out) == before
    assert "volumes/sample/mine.txt" in refused.stderr


# ---- processes


def test_tasks_keep_their_order_and_errors_reach_the_caller():
    tasks = [-3, 1, -2]
    assert (
        list(run_in_order(abs, tasks, LocalPool()))
        == list(run_in_order(abs, tasks, LocalPool(2)))
        == [3, 1, 2]
    )
    with pytest.raises(TypeError, match="bad operand"):
        list(run_in_order(abs, [1, "one", 2], LocalPool(2)))
    with pytest.raises(ConfigError, match="ended from outside"):
        list(run_in_order(os._exit, [1, 1], LocalPool(2)))
