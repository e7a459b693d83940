"""The twin as scans: what is true stands in the volumes at its stated position."""

from dataclasses import replace
from pathlib import Path

import ct_cases as cases
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import map_coordinates

from needlefit.imaging.volume import to_index, to_patient
from needlefit.imaging.volume_files import read_volume
from needlefit.project.locate import shipped_folder
from needlefit.project.tasks import THIS_PROCESS
from needlefit.synthetic import design, render, scans
from needlefit.synthetic.design import select_planned_insertions
from needlefit.synthetic.insertion import TWIN_SEED, simulate_insertion

SHIPPED = shipped_folder() / "data" / "sample_scan"


def quiet(_what, _done, _of):
    """Report nothing."""


def crop(name, seed=1, setup=scans.SAMPLE_SETUP, **scanner):
    """An insertion, its exposure and its volume, in a small field around the sample's needle."""
    twin = simulate_insertion(select_planned_insertions([name])[0], seed)
    exposure = scans.expose(twin, setup, seed)
    exposure = replace(exposure, scanner=replace(exposure.scanner, **scanner))
    return twin, exposure, scans.acquire(exposure, seed, name)


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
    true = scans.sample_whole_needle(twin)
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
    for center in exposure.scene.box.to_world(scans.SAMPLE_SETUP.markers):
        voxels = np.argwhere(volume.values > 700)[:, ::-1]
        places = to_patient(volume, voxels)
        near = np.linalg.norm(places - center, axis=1) < 2.5
        assert_allclose(places[near].mean(axis=0), center, atol=0.06)
    off = np.concatenate(
        [
            (scans.measure_markers(scans.SAMPLE_SETUP, 1, str(n)) - scans.SAMPLE_SETUP.markers).ravel()
            for n in range(200)
        ]
    )
    assert off.std() == pytest.approx(0.1, rel=0.05) and abs(off.mean()) < 0.01


# ---- pose, seed, files


def files(folder):
    return sorted(path for path in Path(folder).rglob("*") if path.is_file())


def test_the_shipped_sample_is_a_rebuild(tmp_path):
    """On the machine that built it to the last byte; elsewhere rounding may turn a voxel by 1 HU."""
    scans.write_scans(tmp_path, [design.SAMPLE_INSERTION], TWIN_SEED, "nrrd", THIS_PROCESS, quiet)
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


# ---- markers


# ---- the command


# ---- processes


# ---- rendered scans: what must be in them whatever the scanner does

VOXEL = cases.SPACING**3


def test_the_voxels_hold_the_volume_of_needle_bevel_and_balls():
    blunt = render.Needle3D(cases.axis()[41:], bevel_deg=90.0)
    metal = render.voxelize_needle(blunt, cases.grid())
    length = np.linalg.norm(np.diff(blunt.points, axis=0), axis=1).sum()
    assert_allclose(metal.part.sum() * VOXEL, np.pi / 4 * 1.27**2 * length, rtol=4e-3)
    assert metal.part.min() >= 0 and metal.part.max() == 1
    center = np.array([[10.1, 11.2, 30.3]])
    metal = render.voxelize_balls(render.SceneMarkers(center, radius=1.5), cases.grid())
    assert_allclose(metal.part.sum() * VOXEL, 4 / 3 * np.pi * 1.5**3, rtol=5e-3)
    mean = (metal.part[:, None] * metal.voxels).sum(axis=0) / metal.part.sum() * cases.SPACING
    assert_allclose(mean, center[0], atol=5e-3)
    for angle in [20.0, 45.0]:
        points = cases.axis(tip=(2.0, 3.0, 28.0))[41:]
        bevelled = render.voxelize_needle(render.Needle3D(points, bevel_deg=angle), cases.grid())
        blunt = render.voxelize_needle(render.Needle3D(points, bevel_deg=90.0), cases.grid())
        cut = np.pi / 8 * 1.27**3 / np.tan(np.deg2rad(angle))
        assert_allclose((blunt.part.sum() - bevelled.part.sum()) * VOXEL, cut, rtol=0.02)
    toward = np.array([0.3, 1.0, 0.2])
    needle = render.Needle3D(cases.axis()[41:], bevel_toward=toward)
    metal = render.voxelize_needle(needle, cases.grid())
    places = metal.voxels * cases.SPACING
    end = places[:, 2] > places[:, 2].max() - 1.0
    center = (metal.part[end, None] * places[end]).sum(axis=0) / metal.part[end].sum()
    assert render.bevel_side(needle) @ (center - cases.ENTRY) > 0.3
    assert_allclose(render.bevel_side(needle)[:2], toward[:2] / np.hypot(*toward[:2]), atol=1e-6)
