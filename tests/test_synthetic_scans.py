"""The twin as scans: what is true stands in the volumes at its stated position."""

from pathlib import Path

import ct_cases as cases
import numpy as np
from numpy.testing import assert_allclose
from scanner import render, twin

from needlefit.imaging.volume_files import read_volume
from needlefit.project.locate import shipped_folder
from needlefit.project.tasks import THIS_PROCESS
from needlefit.synthetic.insertion import TWIN_SEED

SHIPPED = shipped_folder() / "data" / "sample_scan"


def quiet(_what, _done, _of):
    """Report nothing."""


# ---- pose, seed, files


def files(folder):
    return sorted(path for path in Path(folder).rglob("*") if path.is_file())


def test_the_shipped_sample_is_a_rebuild(tmp_path):
    """On the machine that built it to the last byte; elsewhere rounding may turn a voxel by 1 HU."""
    twin.write_scans(tmp_path, [twin.SAMPLE_INSERTION], TWIN_SEED, THIS_PROCESS, quiet)
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


# ---- rendered scans: what must be in them whatever the scanner does

VOXEL = cases.SPACING**3


def test_a_series_has_the_voxels_of_the_file_and_the_same_bytes_again(tmp_path):
    for name in ("a", "b"):
        twin.render_insertion(tmp_path / name, twin.SAMPLE_INSERTION, TWIN_SEED, dicom=True)
    a, b = (files(tmp_path / name / "volumes") for name in ("a", "b"))
    assert len(a) > 100 and [one.read_bytes() for one in a] == [one.read_bytes() for one in b]
    series, file = read_volume(a[0].parent), read_volume(SHIPPED / "volumes" / "sample.nrrd")
    for name in ("origin", "spacing", "direction"):
        assert_allclose(getattr(series, name), getattr(file, name), atol=1e-5)
    assert np.abs(series.values - file.values).max() <= 1


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
