"""Balls at known places in small synthetic scans, and the files that say where markers are."""

import numpy as np
import pytest
from ct_cases import ENTRY, RECIPE, axis, scan
from refusals import refusal
from scanner.render import ScannerTable, SceneMarkers
from scipy.ndimage import label
from scipy.spatial.distance import cdist

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.imaging.bright_voxels import BrightVoxels
from needlefit.imaging.markers import find_markers, refine_fiducials
from needlefit.imaging.needle.segmentation import select_needle
from needlefit.imaging.volume import Volume

PLACES = np.array([[4.13, 4.71, 20.05], [17.32, 5.28, 31.77], [5.55, 16.92, 40.4], [16.4, 17.2, 24.81]])


def with_balls(places=PLACES, radius=1.5, hu=5000.0, table=None, seed=1, **scanner):
    """A scan of a needle and of balls."""
    balls = SceneMarkers(np.asarray(places), radius, hu)
    return scan(axis(), seed, {"markers": balls, "table": table}, **scanner)


def needle_of(volume):
    return select_needle(volume, RECIPE).needle.voxels


def off(found, places=PLACES):
    """Distance of every true place from the nearest ball found, mm; also that none is found elsewhere."""
    apart = cdist(places, found.centers)
    assert found.centers.shape == (len(found.sd), 3)
    assert (apart.min(axis=0) < 0.5).all()
    return apart.min(axis=1)


@pytest.fixture(scope="module")
def plain():
    return with_balls()


@pytest.mark.parametrize(
    "hu",
    [
        5000.0,  # cut at 3071 HU: their flanks alone show
        pytest.param(1500.0, marks=pytest.mark.sweep),
    ],
)
def test_balls_of_any_metal_are_found(plain, hu):
    volume = plain if hu == 5000 else with_balls(hu=hu)
    found = find_markers(volume, RECIPE, needle_of(volume))
    assert found.source == "volume" and off(found).max() < 0.05
    assert (found.sd > 0.002).all() and (found.sd < 0.05).all()


@pytest.mark.sweep
def test_balls_cut_or_touched_and_rails_are_no_markers():
    touching = ENTRY + np.array([0.635 + 1.5, 0, 10.0])
    near = ENTRY + np.array([0.635 + 1.5 + 1.0, 0, 22.0])
    places = np.array([PLACES[0], PLACES[2], touching, near])
    volume = with_balls(places)
    needle = needle_of(volume)
    found = find_markers(volume, RECIPE, needle)
    gaps = cdist(places, found.centers).min(axis=1)
    assert gaps[:2].max() < 0.03
    assert (cdist(found.centers, places).min(axis=1) < 0.15).all()
    places = np.vstack([PLACES, [[0.5, 11.0, 15.0]]])  # the last is cut by a face of the volume
    assert off(find_markers(with_balls(places), RECIPE)).shape == (4,)
    slab = Frame(np.array([19.5, 11.0, 25.0]), np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]))
    places = PLACES * [0.8, 1, 1]
    volume = with_balls(places, table=ScannerTable(slab, width=18.0))
    assert off(find_markers(volume, RECIPE), places).max() < 0.05


def test_a_needle_alone_and_nothing_bright_hold_no_marker():
    volume = scan(axis())
    assert len(find_markers(volume, RECIPE, needle_of(volume)).centers) == 0
    rng = np.random.default_rng(1)
    dull = Volume(
        rng.normal(40, 30, (40, 40, 40)).astype(np.float32), np.zeros(3), np.full(3, 0.5), np.eye(3)
    )
    assert len(find_markers(dull, RECIPE).centers) == 0


# files


@pytest.mark.sweep
def test_fiducials_are_moved_to_the_balls_that_they_mark(plain, tmp_path):
    clicked = PLACES + np.array([[0.5, 0.2, -0.3], [-1.2, 0, 0.9], [0, 0, 0], [0.3, 0.3, 0.3]])
    landmark = np.array([[10.0, 20.0, 45.0]])  # no ball there
    balls = find_markers(plain, RECIPE)
    given = np.vstack([clicked, landmark])
    moved = refine_fiducials(given, plain, RECIPE, balls)
    assert moved.source == "fiducials"
    assert np.linalg.norm(moved.centers[:4] - PLACES, axis=1).max() < 0.03
    assert (moved.sd[:4] < 0.05).all()
    np.testing.assert_allclose(moved.centers[4:], landmark)
    assert moved.sd[4] == 0.3
    given = np.array([[10.0, 10.0, 20.0], [80.0, 10.0, 20.0]])
    refusal(DataError, "1 of 2 fiducials", refine_fiducials, given, plain, RECIPE, balls)
    refusal(DataError, r"RAS.* LPS", refine_fiducials, PLACES * [-1, -1, 1], plain, RECIPE, balls)


def test_bright_voxels_hang_together_as_scipy_labels_them():
    mask = np.random.default_rng(1).random((9, 20, 30)) < 0.08
    flat = np.flatnonzero(mask)
    labels = BrightVoxels(mask.shape, 0.0, flat, np.ones(len(flat), np.float32)).label(0.5)[1]
    known = label(mask, np.ones((3, 3, 3)))[0].ravel()[flat]
    assert len(set(zip(labels, known, strict=True))) == len(set(labels)) == len(set(known)) > 5
