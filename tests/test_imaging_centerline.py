"""The needle's axis and tip from scans of needles of known equation."""

import re
from dataclasses import replace
from pathlib import Path

import ct_cases as cases
import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydantic import ValidationError
from reconstruction_cases import small
from scipy.special import ndtr

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.geometry.smoothing_spline import find_empty_pieces
from needlefit.imaging.needle import centerline, tip
from needlefit.imaging.needle.axis_spline import (
    SHIFT_PER_TILT_MM,
    CrossSections,
    estimate_shared_sd,
    fit_axis,
)
from needlefit.imaging.needle.segmentation import find_components, list_thresholds, segment_needle
from needlefit.imaging.needle.tip import RodModel
from needlefit.imaging.reconstruct import MAX_DEPTH_SD_MM, collect_warnings, examine, list_tip_warnings
from needlefit.imaging.scans import Scan
from needlefit.imaging.spheres import PointSpread
from needlefit.imaging.volume import Volume
from needlefit.project.toml import load
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.synthetic.render import ScannerTable, SceneMarkers

FAR = np.array([200.0, 0.0, 0.0])
SHAPES = {
    "straight": {},
    "tilted": {"tip": (4.0, -3.0, 27.0)},
    "curved": {"curve": (3.0, 0.0)},
    "out of plane": {"tip": (1.0, 2.0, 28.0), "curve": (-2.0, 3.0)},
}


def found(volume, recipe=cases.RECIPE):
    return centerline.trace_needle(volume, segment_needle(volume, recipe), recipe)


@pytest.mark.parametrize("name", SHAPES)
def test_needles_of_known_equation(name):
    truth = cases.axis(**SHAPES[name])
    line = found(cases.scan(truth))
    errors = cases.off(line.points, truth)
    assert errors.mean() < 0.03
    assert errors.max() < 0.10
    assert np.linalg.norm(line.tip - truth[-1]) < 0.12
    assert_allclose(line.points[-1], line.tip)
    steps = np.linalg.norm(np.diff(line.points, axis=0), axis=1)
    assert_allclose(steps, steps.mean(), rtol=0.02)  # even in arc length
    assert line.sd.shape == (len(line.points),)
    assert 0 < line.sd.max() < 0.1
    assert line.bevel @ [0, 1, 0] > 0.9


@pytest.mark.sweep
def test_thick_slices_and_ends_in_tissue():
    truth = cases.axis(tip=(3.0, 2.0, 28.0), curve=(2.0, 0.0))
    grid = cases.grid(size=(48, 48, 56), spacing=np.array([0.46, 0.46, 0.9]))
    line = found(cases.scan(truth, grid=grid))
    assert cases.off(line.points, truth).mean() < 0.05
    assert np.linalg.norm(line.tip - truth[-1]) < 0.2
    truth = cases.axis()[34:]  # base in air, 6 mm above the face
    line = found(cases.scan(truth))
    assert np.linalg.norm(line.tip - truth[-1]) < 0.15
    truth = cases.axis()[48:]  # base 4 mm under the face
    volume = cases.scan(truth)
    with pytest.raises(DataError, match="entry_direction"):
        found(volume)
    line = found(volume, cases.recipe(centerline={"entry_direction": [0, 0, 1]}))
    assert np.linalg.norm(line.tip - truth[-1]) < 0.15


@pytest.mark.sweep
def test_markers_rays_and_table_change_nothing():
    truth = cases.axis(curve=(2.0, 1.0))
    balls = SceneMarkers(cases.ENTRY + np.array([[6.0, 3, 4], [-5, -6, 12], [4, -6, 20], [-7, 5, 30]]))
    frame = Frame(np.array([11.0, 19.0, 25.0]), np.array([[0.0, 1, 0], [0, 0, -1], [1, 0, 0]]))
    scene = {"markers": balls, "table": ScannerTable(frame, width=18.0, thickness=3.0)}
    volume = cases.scan(truth, scene=scene, streaks=1.0, bloom=0.12, cupping_hu=60.0)
    low, high = list_thresholds(volume, cases.RECIPE)[0]
    assert len(find_components(volume, low, high)) >= 6  # needle, balls and rails stand apart
    line = found(volume)
    assert cases.off(line.points, truth).mean() < 0.05
    assert np.linalg.norm(line.tip - truth[-1]) < 0.2


@pytest.mark.sweep
def test_pieces_of_one_needle_are_joined():
    truth = cases.axis()
    volume = cases.scan(truth)
    volume.values[60:70] = 40.0  # 4.6 mm wiped out by a ray
    line = found(volume)
    assert line.points[0, 2] < 8.0
    assert np.linalg.norm(line.tip - truth[-1]) < 0.12
    assert cases.off(line.points, truth).max() < 0.1


def test_what_is_no_needle_is_refused():
    with pytest.raises(DataError, match="tissue"):
        segment_needle(cases.scan(cases.axis() + FAR), cases.RECIPE)
    balls = SceneMarkers(cases.ENTRY + np.array([[6.0, 3, 4], [-5, -6, 12], [4, -6, 20], [-7, 5, 30]]))
    volume = cases.scan(cases.axis() + FAR, scene={"markers": balls})
    with pytest.raises(DataError, match="is a tube"):
        segment_needle(volume, cases.RECIPE)
    with pytest.raises(DataError, match=r"volume.* tip"):
        found(cases.scan(cases.axis(tip=(0.0, 0.0, 60.0))))
    recipe = cases.recipe(segmentation={"threshold_low_hu": 2000, "threshold_high_hu": 9000})
    with pytest.raises(DataError, match="9000 HU"):
        segment_needle(cases.scan(cases.axis()), recipe)
    recipe = cases.recipe(centerline={"entry_direction": [0, 0, -1]})
    with pytest.raises(DataError, match=r"volume.* tip"):
        found(cases.scan(cases.axis()), recipe)


@pytest.mark.parametrize("contact", [None, cases.ENTRY])
def test_a_needle_whose_tip_alone_leaves_the_volume_is_not_reversed(tmp_path, contact):
    """The base lies in air, 28 mm before the face; the volume ends 5 or 12 mm before the tip."""
    for top in (35.0, 28.0):
        size = (48, 48, int((top + 22.0) / cases.SPACING))
        cut = cases.scan(cases.axis(), grid=cases.grid(size=size, origin=np.array([0, 0, -22.0])))
        scan = Scan("cut", tmp_path / "cut.nrrd", "box", contact=contact)
        refused = examine(cut, scan, cases.RECIPE).error
        assert refused is not None and "entry_direction" in refused.fix
        soft = [float(length) for length in re.findall(r"(\d+) mm", refused.what)]
        assert_allclose(soft, [top - 12.0, 0.0], atol=1.5)


@pytest.mark.sweep
def test_a_ray_beside_the_needle_pulls_no_further_than_stated():
    """A ridge of 400 HU runs along the needle, 1 mm beside it: every section is pulled alike."""
    truth = cases.axis(tip=(1.0, 2.0, 28.0))
    volume = cases.scan(truth)
    still = found(volume)
    k, _, i = np.indices(volume.values.shape) * cases.SPACING
    beside = i - np.interp(k, truth[:, 2], truth[:, 0]) - 1.0
    ridge = 400 * np.exp(-0.5 * (beside / 0.5) ** 2) * (k > cases.ENTRY[2])
    volume.values[:] = np.minimum(volume.values + ridge, volume.values.max())
    pulled = found(volume)
    errors = cases.off(pulled.points, truth)
    assert pulled.sd.mean() > 3 * still.sd.mean()
    assert np.sqrt(np.mean(errors**2) / 2) < 2 * pulled.sd.mean()


def sections(shifts, tilt=0.0):
    """Forty sections of 1000 HU with `shifts` along u; the background slopes by `tilt` (HU/mm) along v."""
    flat = np.zeros(40)
    across = np.column_stack([shifts + flat, flat])
    return CrossSections(across, flat + 1000.0, flat + 10.0, np.column_stack([flat, flat + tilt]))


def test_errors_shared_by_sections_gaps_and_thick_slices():
    none = sections(0.0)
    assert estimate_shared_sd(none, none, 0.5) == 0.0
    apart = sections(0.02)  # 0.02 mm along one of two directions
    assert_allclose(estimate_shared_sd(apart, none, 0.5), 0.02 / np.sqrt(2))
    sloping = sections(0.0, tilt=3.0)  # 3 / 1000 of the needle's brightness per mm
    assert_allclose(estimate_shared_sd(sloping, sloping, 0.5), SHIFT_PER_TILT_MM * 3e-3 / np.sqrt(2))
    assert_allclose(
        estimate_shared_sd(apart, sloping, 0.5), np.hypot(0.02, SHIFT_PER_TILT_MM * 3e-3) / np.sqrt(2)
    )
    assert (
        estimate_shared_sd(sections(0.02 * (-1.0) ** np.arange(40)), none, 0.5) < 0.001
    )  # neighbours make up for it
    s = np.concatenate([np.arange(0.0, 20.0, 0.5), np.arange(40.0, 60.1, 0.5)])
    points = np.column_stack([s, 0.001 * s**2, 0 * s])
    axis = fit_axis(s, points, np.ones(len(s)), 7.0)
    assert not len(find_empty_pieces(s, axis.final_weights, axis.spline.t))
    assert np.abs(axis.spline(30.0) - [30.0, 0.9, 0.0]).max() < 0.01

    def deviation(thick, way):
        s = np.arange(0.0, 60.0, 0.5)
        axis = fit_axis(s, np.outer(s, np.array(way) / np.linalg.norm(way)), np.ones(len(s)), 7.0)
        grid = np.zeros((4, 4, 4), np.float32)
        return centerline.slice_sd(
            Volume(grid, np.zeros(3), np.array([0.5, 0.5, thick]), np.eye(3)), axis, cases.RECIPE
        )

    assert 0.2 < deviation(2.0, [1, 0, 0]) < 2 / np.sqrt(12)
    assert deviation(0.4, [1, 0, 0]) < 0.03
    assert deviation(2.0, [0, 0, 1]) < 0.03


@pytest.mark.parametrize(
    "table",
    [
        {"segmentation": {"threshold_low_hu": 2000.0, "threshold_high_hu": 1000.0}},
        {"centerline": {"entry_direction": [0.0, 0.0, 0.0]}},
        {"needle": {"diameter_mm": 0.0}},
        {"centerline": {"station_spacing_mm": 1e-4}},
        {"centerline": {"patch_width_mm": 1e3}},
        {"centerline": {"knot_spacing_mm": 0.1}},
        {"centerline": {"knot_spacing_mm": 1e4}},
    ],
)
def test_recipes_that_contradict_themselves(table):
    with pytest.raises(ValidationError):
        cases.recipe(**table)


def test_a_blunt_needle_has_no_side_and_the_shipped_recipe_states_the_defaults():
    truth = cases.axis(tip=(1.0, 2.0, 28.0))
    line = found(cases.scan(truth, bevel_deg=90.0), cases.recipe(needle={"bevel_deg": 90.0}))
    assert np.linalg.norm(line.tip - truth[-1]) < 0.05
    assert np.isnan(line.bevel).all()
    shipped = load(Path(__file__).parents[1] / "configs/reconstruction/default.toml", ReconstructionRecord)
    assert shipped.model_copy(update={"title": ""}) == cases.RECIPE


# ---- the image of a needle's end

RADIUS = 0.635
TRUTH = cases.axis(tip=(1.0, 2.0, 28.0))


def rod_image(spread, s, u=0.0, *, cotangent=0.0, roll=0.0, normal=(1.0, 0.0, 0.0)):
    """Return the image of a rod at places s and u."""
    model = RodModel(RADIUS, 8.0, 6.0, 2.9, normal)
    s, u = np.broadcast_arrays(np.atleast_1d(s).astype(float), u)
    splines = model.splines(model.transform(roll, cotangent), spread)
    return model.sample(splines, s, np.asarray(u, dtype=float), 0 * s)


def trace(volume, needle=cases.RECIPE):
    return centerline.trace_needle(volume, segment_needle(volume, needle), needle)


def test_an_end_fades_as_its_blur_does_and_a_bevel_s_point_lies_at_its_roll():
    spread = PointSpread(0.45, 0.0, 0.3)
    # across a Gaussian of a disc; by hand: 1 - exp(-r^2 / 2 sigma^2)
    middle = 1 - np.exp(-(RADIUS**2) / (2 * 0.45**2))
    assert_allclose(rod_image(spread, -4.0), middle, atol=0.01)
    assert_allclose(rod_image(spread, 0.0), middle / 2, atol=0.01)
    along = np.array([-0.5, -0.2, 0.2, 0.5])
    upright = {"normal": (0.0, 0.0, 1.0)}
    in_slices = rod_image(spread, along, **upright) / rod_image(spread, -4.0, **upright)
    assert_allclose(in_slices, ndtr(-along / 0.45), atol=0.01)
    sharp, plain = PointSpread(0.35, 3.0, 0.3), PointSpread(0.35, 0.0, 0.3)
    beside = np.linspace(0.8, 2.0, 13)
    assert rod_image(sharp, -4.0, beside).min() < -0.02
    assert rod_image(plain, -4.0, beside).min() > -0.005
    spread = PointSpread(0.35, 0.0, 0.2)
    toward, away = (rod_image(spread, -0.6, u, cotangent=1.732) for u in (0.4, -0.4))
    assert toward > 2 * away
    assert_allclose(rod_image(spread, -0.6, -0.4, cotangent=1.732, roll=np.pi), toward, rtol=0.02)


@pytest.mark.sweep
def test_a_model_that_is_not_to_be_trusted_gives_way_to_the_threshold(monkeypatch):
    volume = cases.scan(TRUTH)
    by_model = trace(volume)
    assert by_model.tip_source == "model"
    assert abs(by_model.tip_disagreement) < 0.5
    monkeypatch.setattr(tip, "MAX_MODEL_SD_MM", 1e-6)
    by_threshold = trace(volume)
    assert by_threshold.tip_source == "threshold"
    assert np.isnan(by_threshold.bevel).all()
    assert np.linalg.norm(by_threshold.tip - TRUTH[-1]) < 0.6
    assert by_threshold.tip_sd[0] >= cases.SPACING / 2


def test_ends_that_nothing_shows_are_refused_and_unsure_ones_are_warnings():
    with pytest.raises(DataError, match="does not show") as caught:
        tip._end_by_threshold(60.0, np.inf, cases.scan(TRUTH))
    assert caught.value.fix
    one = small()
    with pytest.raises(DataError, match="inserted length"):
        collect_warnings(replace(one, depth_sd=1.01 * MAX_DEPTH_SD_MM))
    unsure = replace(one, needle_axis=replace(one.needle_axis, tip_sd=np.array([0.8, 0.1])))
    assert "0.80 mm" in collect_warnings(unsure)[0]
    fallen = replace(one, needle_axis=replace(one.needle_axis, tip_source="threshold"))
    assert "threshold" in collect_warnings(fallen)[0]
    # The needle's last 6 mm begin behind a gap of 3 mm.
    one = small()
    assert not any("beyond the tip" in note for note in list_tip_warnings(one))
    s, core = one.profile.s, one.profile.core.copy()
    core[(s > one.depth + 3.0) & (s < one.depth + 6.0)] = 2500.0
    notes = list_tip_warnings(replace(one, profile=replace(one.profile, core=core)))
    (distance,) = re.findall(r"(\d\.\d) mm beyond", notes[-1])
    assert_allclose(float(distance), 3.0, atol=0.6)


@pytest.mark.sweep
def test_the_bevel_s_side_is_left_open_where_noise_hides_it():
    clear = trace(cases.scan(TRUTH, psf_mm=0.3))
    assert clear.bevel_probability > tip.MIN_BEVEL_PROBABILITY
    assert clear.bevel[1] > np.cos(np.radians(25))
    hidden = trace(cases.scan(TRUTH, psf_mm=0.8, noise_hu=150.0))
    assert hidden.bevel_probability < tip.MIN_BEVEL_PROBABILITY
    assert np.isnan(hidden.bevel).all()


@pytest.mark.sweep
def test_what_rays_hide_grows_with_the_needle_that_they_pass(monkeypatch):
    volume = cases.scan(TRUTH)
    seen = trace(volume)  # along the slices' normal: rays pass no more than its width and a slice
    assert 0 < seen.hidden_length < 2.5
    monkeypatch.setattr(tip, "measure_ray", lambda *known: 30.0)
    hidden = trace(volume)
    assert hidden.hidden_length == 30.0
    assert hidden.tip_sd[0] >= 30.0 * tip.HIDDEN_END_SD_PER_MM > seen.tip_sd[0]
    one = small()
    notes = collect_warnings(
        replace(one, needle_axis=replace(one.needle_axis, hidden_length=30.0)), ("other",)
    )
    assert notes.index("other") == 1 and "30 mm" in notes[0]
