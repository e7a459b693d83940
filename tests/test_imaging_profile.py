"""Brightness along needles, the edge of the tissue, and pictures of the scan: known edges, known volumes."""

from dataclasses import replace

import ct_cases as cases
import numpy as np
import pytest
from refusals import refusal
from scanner.render import Needle3D, Scanner, Scene3D, SceneMarkers, render_scan
from synthetic.design import Phantom
from test_imaging_entry import profile

from needlefit.errors import DataError
from needlefit.geometry.frames import make_entry_frame
from needlefit.imaging.materials import list_materials, sample_profile
from needlefit.imaging.reconstruction import IntensityProfile
from needlefit.imaging.volume import require_hounsfield

S = np.arange(-30.0, 30.0, 0.5)


def edge(at, width=0.6, noise=5.0, seed=1):
    """Brightness that turns from air into tissue at `at`."""
    return profile((at, 40.0), width=width, noise=noise, seed=seed, s=S).around


def find_last_face(around):
    faces = [run for run in list_materials(IntensityProfile(S, around), S[-1]) if run.behind_air]
    return (faces[-1].begin, faces[-1].sd) if faces else None


# the edge of the tissue


@pytest.mark.parametrize("at", [-11.37, 0.05, 4.21])
def test_an_edge_is_found_where_it_is(at):
    for width in [0.4, 1.5]:
        place, sd = find_last_face(edge(at, width))
        assert abs(place - at) < 0.05
        assert 0.015 < sd < 0.04 + 0.12 * width  # kernels and slices blur both sides differently
    place, sd = find_last_face(edge(at, width=0.02, noise=0.5))
    assert abs(place - at) < 0.5 and sd < 0.2


def test_the_deviation_covers_the_scatter():
    found = np.array(
        [[find_last_face(edge(1.2, noise=n, seed=seed)) for seed in range(40)] for n in (20, 60)]
    )
    scatter, stated = found[:, :, 0].std(axis=1), found[:, :, 1].mean(axis=1)
    assert (stated > scatter).all() and (stated < 5 * scatter).all()
    assert stated[1] > 1.4 * stated[0]


@pytest.mark.parametrize(
    "around",
    [
        np.full(len(S), 35.0),
        np.full(len(S), np.nan),
        edge(29.0),  # a millimetre of tissue is none
        np.where(S < 0, -560.0, -440.0),  # lung, perhaps: no edge of air
        1000.0 - edge(0.0),  # tissue before air
    ],
)
def test_there_is_no_face_where_nothing_shows(around):
    assert find_last_face(around) is None


@pytest.mark.parametrize("tilt", [0.0, 20.0, 30.0])
def test_a_face_is_found_where_the_needle_passes_however_it_slants(tilt):
    box = make_entry_frame(cases.ENTRY, (np.sin(np.deg2rad(tilt)), 0, np.cos(np.deg2rad(tilt))), (0, 1, 0))
    markers = SceneMarkers(np.array([[15.5, 11.0, 12.5], [11.0, 6.5, 16.0]]))
    scene = Scene3D((Needle3D(cases.axis()),), Phantom((14.0,)), (40.0, 90.0), box, markers)
    volume = render_scan(scene, Scanner(cases.grid(), noise_hu=50.0), np.random.default_rng(4))
    s = np.arange(-11.0, 20.0, 0.5)
    shown = sample_profile(volume, cases.ENTRY + np.outer(s, [0, 0, 1]), s)
    face = [run for run in list_materials(shown, 20.0) if run.behind_air][-1]
    assert abs(face.begin) < max(0.08, 2.5 * face.sd)
    assert face.sd < 0.12


# pictures


@pytest.mark.parametrize(
    "convert",
    [
        lambda hu: np.clip(hu + 1024, 0, 4095),
        lambda hu: np.clip(hu + 1000, 0, None) * 2e-4,
        lambda hu: (np.clip(hu + 1000, 0, None) * 2e-4) - 0.01,  # noise below 0
        lambda hu: np.abs(hu + 1000) / 3,
    ],
)
def test_values_that_are_no_hu_are_refused(convert):
    volume = cases.scan(cases.axis())
    require_hounsfield(volume)
    other = replace(volume, values=convert(volume.values.astype(np.float64)).astype(np.float32))
    refused = refusal(DataError, "Hounsfield", require_hounsfield, other)
    assert refused.fix
