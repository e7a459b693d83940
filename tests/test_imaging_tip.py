"""The image of a needle's end, what is done where it explains nothing, and when a bevel has a side."""

import re
from dataclasses import replace

import ct_cases as cases
import numpy as np
import pytest
from numpy.testing import assert_allclose
from reconstruction_cases import small
from scipy.special import ndtr

from needlefit.errors import DataError
from needlefit.imaging.needle import tip
from needlefit.imaging.needle.centerline import (
    BEVEL_MARGIN_MM,
    _find_tip,
    fit_rough_axis,
    orient_axis,
    refine_axis,
    trace_needle,
)
from needlefit.imaging.needle.segmentation import segment_needle
from needlefit.imaging.needle.tip import RodModel
from needlefit.imaging.reconstruction_checks import MAX_DEPTH_SD_MM, collect_warnings, list_tip_warnings
from needlefit.imaging.spheres import PointSpread

RADIUS = 0.635
TRUTH = cases.axis(tip=(1.0, 2.0, 28.0))
HEEL = tip.bevel_length(cases.RECIPE.needle) + BEVEL_MARGIN_MM


def rod_image(spread, s, u=0.0, *, cotangent=0.0, roll=0.0, normal=(1.0, 0.0, 0.0)):
    """Return the image of a rod at places s and u."""
    model = RodModel(RADIUS, 8.0, 6.0, 2.9, normal)
    s, u = np.broadcast_arrays(np.atleast_1d(s).astype(float), u)
    splines = model.splines(model.transform(roll, cotangent), spread)
    return model.sample(splines, s, np.asarray(u, dtype=float), 0 * s)


def trace(volume, needle=cases.RECIPE):
    return trace_needle(volume, segment_needle(volume, needle), needle)


def _rough_axis(volume):
    rough = fit_rough_axis(volume, segment_needle(volume, cases.RECIPE), cases.RECIPE)
    return orient_axis(volume, rough, cases.RECIPE)


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
def test_a_tip_behind_a_dark_stretch_is_found():
    """Rays hide 4 mm of the shaft, and the search begins before them, 10 mm before the tip."""
    volume = cases.scan(TRUTH)
    axis = refine_axis(volume, _rough_axis(volume), cases.RECIPE, HEEL)
    tip_at = _find_tip(volume, axis, cases.RECIPE, axis.length + HEEL, None).at
    values = volume.values.copy()
    gap = slice(*(int(z / cases.SPACING) for z in (29.0, 33.0)))
    values[gap] = np.minimum(values[gap], 100.0)
    found = _find_tip(replace(volume, values=values), axis, cases.RECIPE, tip_at - 10.0, None)
    assert abs(found.at - tip_at) < 0.3


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
