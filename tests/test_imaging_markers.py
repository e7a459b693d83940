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


def with_balls(places=PLACES, hu=5000.0, table=None):
    """A scan of a needle and of balls."""
    return scan(axis(), scene={"markers": SceneMarkers(np.asarray(places), 1.5, hu), "table": table})


def find(volume):
    return find_markers(volume, RECIPE, select_needle(volume, RECIPE).needle.voxels)


def off(found, places=PLACES):
    """Distance of every true place from the nearest ball found, mm; also that none is found elsewhere."""
    apart = cdist(places, found.centers)
    assert (apart.min(axis=0) < 0.15).all()
    return apart.min(axis=1)


@pytest.fixture(scope="module")
def plain():
    return with_balls()


def test_balls_are_found_whose_flanks_alone_show(plain):
    found = find(plain)  # cut at 3071 HU
    assert found.source == "volume" and off(found).max() < 0.05
    assert (found.sd > 0.002).all() and (found.sd < 0.05).all()


@pytest.mark.sweep
def test_dull_balls_are_found_and_those_cut_or_touched_and_rails_are_not():
    assert off(find(with_balls(hu=1500.0))).max() < 0.05
    touching, near = ENTRY + np.array([[2.135, 0, 10.0], [3.135, 0, 22.0]])
    places = np.array([PLACES[0], PLACES[2], touching, near])
    assert off(find(with_balls(places)), places)[:2].max() < 0.03
    places = np.vstack([PLACES, [[0.5, 11.0, 15.0]]])  # the last is cut by a face of the volume
    assert off(find_markers(with_balls(places), RECIPE)).max() < 0.05
    slab = Frame(np.array([19.5, 11.0, 25.0]), np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]))
    places = PLACES * [0.8, 1, 1]
    volume = with_balls(places, table=ScannerTable(slab, width=18.0))
    assert off(find_markers(volume, RECIPE), places).max() < 0.05


def test_a_needle_alone_and_nothing_bright_hold_no_marker():
    assert len(find(scan(axis())).centers) == 0
    noise = np.random.default_rng(1).normal(40, 30, (40, 40, 40)).astype(np.float32)
    dull = Volume(noise, np.zeros(3), np.full(3, 0.5), np.eye(3))
    assert len(find_markers(dull, RECIPE).centers) == 0


# files


@pytest.mark.sweep
def test_fiducials_are_moved_to_the_balls_that_they_mark(plain, tmp_path):
    clicks = np.array([[0.5, 0.2, -0.3], [-1.2, 0, 0.9], [0, 0, 0], [0.3, 0.3, 0.3]])
    given = np.vstack([PLACES + clicks, [[10.0, 20.0, 45.0]]])  # no ball at the last
    balls = find_markers(plain, RECIPE)
    moved = refine_fiducials(given, plain, RECIPE, balls)
    assert moved.source == "fiducials"
    assert np.linalg.norm(moved.centers[:4] - PLACES, axis=1).max() < 0.03
    assert moved.centers[4].tolist() == given[4].tolist()
    assert (moved.sd[:4] < 0.05).all() and moved.sd[4] == 0.3
    for places, words in ((given + 70.0, "5 of 5 fiducials"), (PLACES * [-1, -1, 1], r"RAS.* LPS")):
        refusal(DataError, words, refine_fiducials, places, plain, RECIPE, balls)


def test_bright_voxels_hang_together_as_scipy_labels_them():
    mask = np.random.default_rng(1).random((9, 20, 30)) < 0.08
    flat = np.flatnonzero(mask)
    labels = BrightVoxels(mask.shape, 0.0, flat, np.ones(len(flat), np.float32)).label(0.5)[1]
    known = label(mask, np.ones((3, 3, 3)))[0].ravel()[flat]
    assert len(set(zip(labels, known, strict=True))) == len(set(labels)) == len(set(known)) > 5
