"""Brightness along needles, the edge of the tissue, and pictures of the scan: known edges, known volumes."""

from dataclasses import replace

import ct_cases as cases
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refusal
from scipy.special import ndtr

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame, make_entry_frame
from needlefit.imaging.materials import find_tissue_edge, sample_profile
from needlefit.imaging.reconstruction import IntensityProfile, render_views
from needlefit.imaging.volume import Volume, require_hounsfield, to_patient
from needlefit.synthetic.design import Phantom
from needlefit.synthetic.render import Needle3D, Scanner, Scene3D, SceneMarkers, render_scan

S = np.arange(-30.0, 30.0, 0.5)


def edge(at, width=0.6, tissue=40.0, noise=5.0, seed=1):
    """A profile whose surroundings turn from air into tissue at `at`."""
    clean = -1000 + (tissue + 1000) * ndtr((S - at) / width)
    return clean + noise * np.random.default_rng(seed).normal(size=len(S))


def found(around):
    return find_tissue_edge(IntensityProfile(S, np.full(len(S), 3000.0), around))


def linear(gradient, constant=0.0, shape=(40, 50, 60), spacing=(0.5, 0.4, 0.6)):
    """A volume whose brightness is `gradient` . LPS + `constant`; its axes are turned."""
    direction = np.array([[0.0, 0.6, 0.8], [1.0, 0, 0], [0, 0.8, -0.6]])
    volume = Volume(np.zeros(shape, np.float32), np.array([5.0, -3, 8]), np.array(spacing), direction)
    k, j, i = np.indices(shape)
    ijk = np.stack([i, j, k], axis=-1).reshape(-1, 3)
    values = to_patient(volume, ijk) @ gradient + constant
    return Volume(values.reshape(shape).astype(np.float32), volume.origin, volume.spacing, direction)


def middle(volume):
    return to_patient(volume, (np.array(volume.values.shape[::-1]) - 1)[None] / 2)[0]


# the edge of the tissue


def test_an_edge_is_found_where_it_is():
    for at in [-11.37, 0.0, 4.21]:
        for width in [0.4, 1.5]:
            place, sd = found(edge(at, width))
            assert abs(place - at) < 0.05
            assert 0.02 < sd < 0.04 + 0.12 * width  # kernels and slices blur both sides differently
    for at in [0.05, 0.25, 0.45]:
        place, sd = found(edge(at, width=0.02, noise=0.5))
        assert abs(place - at) < 0.5
        assert sd < 0.2


def test_neither_cupping_nor_a_layer_near_by_nor_gaps_move_the_edge():
    around = edge(2.3)
    around += np.where(S > 2.3, -6 * np.clip(S - 2.3, 0, 20), 0)  # a slope
    around += np.where(S > 6.3, 150.0, 0)  # another layer 4 mm behind
    around[[50, 71, 76]] += [300, -400, 350]  # rays
    place, _ = found(around)
    assert abs(place - 2.3) < 0.1
    around = edge(3.0)
    around[S < -10] = np.nan
    around[::7] = np.nan
    assert abs(found(around)[0] - 3.0) < 0.06


def test_the_deviation_covers_the_scatter_and_there_is_no_edge_where_nothing_shows():
    answers = np.array([[found(edge(1.2, noise=n, seed=seed)) for seed in range(40)] for n in (20, 60)])
    scatter, stated = answers[:, :, 0].std(axis=1), answers[:, :, 1].mean(axis=1)
    assert (stated > scatter).all() and (stated < 5 * scatter).all()
    assert stated[1] > 1.5 * stated[0]
    for around in [
        np.full(len(S), 35.0),
        np.full(len(S), -1000.0),
        np.full(len(S), np.nan),
        edge(29.0),  # a millimetre of tissue is none
        np.where(S < 0, -560.0, -440.0),  # lung, perhaps: no edge of air
        1000.0 - edge(0.0),  # tissue before air
    ]:
        assert found(np.array(around)) is None


@pytest.mark.parametrize("tilt", [0.0, 20.0, 30.0])
def test_a_face_is_found_where_the_needle_passes_however_it_slants(tilt):
    box = make_entry_frame(cases.ENTRY, (np.sin(np.deg2rad(tilt)), 0, np.cos(np.deg2rad(tilt))), (0, 1, 0))
    markers = SceneMarkers(np.array([[15.5, 11.0, 12.5], [11.0, 6.5, 16.0]]))
    scene = Scene3D((Needle3D(cases.axis()),), Phantom((14.0,)), (40.0, 90.0), box, markers)
    volume = render_scan(scene, Scanner(cases.grid(), noise_hu=50.0), np.random.default_rng(4))
    s = np.arange(-11.0, 20.0, 0.5)
    shown = sample_profile(volume, cases.ENTRY + np.outer(s, [0, 0, 1]), s)
    place, sd = find_tissue_edge(shown)
    assert abs(place) < max(0.08, 2.5 * sd)
    assert sd < 0.12


def test_a_slanting_face_at_the_side_of_the_volume_stays_where_it_is():
    """Of the ring a third lies outside; the points opposite do not count either."""
    box = make_entry_frame(cases.ENTRY, (0.4, 0, 1), (0, 1, 0))
    scene = Scene3D((), Phantom(()), (40.0,), box)
    cut = cases.grid(size=(31, 48, 60))  # ends 2.8 mm beside the needle
    volume = render_scan(scene, Scanner(cut, streaks=0, cupping_hu=0, noise_hu=20), np.random.default_rng(1))
    s = np.arange(-11.0, 14.0, 0.5)
    place, _ = find_tissue_edge(sample_profile(volume, cases.ENTRY + np.outer(s, [0, 0, 1]), s))
    assert abs(place) < 0.06


# the profile


def test_in_a_linear_volume_core_and_surroundings_are_that_of_the_axis():
    gradient = np.array([3.0, -20.0, 11.0])
    volume = linear(gradient, 100.0)
    way = np.array([0.2, 0.9, -0.3]) / np.linalg.norm([0.2, 0.9, -0.3])
    s = np.linspace(-3, 3, 13)
    points = middle(volume) + s[:, None] * way
    shown = sample_profile(volume, points, s)
    assert_allclose(shown.core, points @ gradient + 100, atol=1e-3)
    assert_allclose(shown.around, points @ gradient + 100, atol=1e-3)
    assert_allclose(shown.s, s)
    volume = linear(np.zeros(3))
    points = middle(volume) + np.linspace(0, 60, 31)[:, None] * [0.0, 1.0, 0.0]
    shown = sample_profile(volume, points, np.linspace(0, 60, 31))
    assert np.isfinite(shown.core[0]) and np.isfinite(shown.around[0])
    assert np.isnan(shown.core[-1]) and np.isnan(shown.around[-1])


# pictures


def test_the_picture_shows_needle_entry_and_tip_where_they_are():
    volume = cases.scan(cases.axis())
    frame = Frame(cases.ENTRY, np.column_stack([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]]))
    view = render_views(volume, Frame(np.zeros(3), np.eye(3)), frame, cases.axis())[0]
    left, _, bottom, _ = view.extent
    needle_row = view.values[round((0.0 - bottom) / 0.3 - 0.5)]
    x = left + 0.3 * (np.arange(view.values.shape[1]) + 0.5)
    assert needle_row[(x > -8) & (x < 24)].min() > 500
    assert needle_row[x > 30].max() < 400
    beside = view.values[round((6.0 - bottom) / 0.3 - 0.5)]
    assert beside[(x > -8) & (x < -2)].max() < -800
    assert beside[(x > 2) & (x < 12)].mean() == pytest.approx(40, abs=10)
    assert beside[(x > 16) & (x < 35)].mean() == pytest.approx(90, abs=10)


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
    require_hounsfield(volume, "scan.nrrd")
    other = replace(volume, values=convert(volume.values.astype(np.float64)).astype(np.float32))
    refused = refusal(DataError, "Hounsfield", require_hounsfield, other, "scan.nrrd")
    assert refused.where == "scan.nrrd" and refused.fix


@pytest.mark.sweep
@pytest.mark.parametrize(("voxel", "psf"), [(0.46, 0.35), (0.3, 0.3)])
def test_metal_that_runs_over_twelve_bits_is_named(voxel, psf):
    shape = cases.grid(
        size=tuple(round(n * cases.SPACING / voxel) for n in cases.SHAPE), spacing=np.full(3, voxel)
    )
    volume = cases.scan(cases.axis(), grid=shape, psf_mm=psf, ceiling_hu=30000.0)
    require_hounsfield(volume, "")
    require_hounsfield(replace(volume, values=np.minimum(volume.values, 3071)), "")
    wrapped = replace(volume, values=(volume.values + 1024) % 4096 - 1024)
    refusal(DataError, "12 bits", require_hounsfield, wrapped, "")
