"""Where the needle first touched: known brightness along it, known beams, known stages."""

import re
from dataclasses import replace
from pathlib import Path

import ct_cases as cases
import numpy as np
import pytest
from layer_cases import save_mesh
from numpy.testing import assert_allclose
from pytest import approx
from refusals import refusal
from scanner.write import write_volume
from scipy.special import ndtr

from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.surfaces import make_sheet
from needlefit.imaging.batch import reconstruct_needles
from needlefit.imaging.checks import compare_poses
from needlefit.imaging.entry import choose_entry
from needlefit.imaging.materials import cut_runs, list_materials
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.needle.tip import TipFit
from needlefit.imaging.pose import find_first_contact, pose_from_shaft
from needlefit.imaging.reconstruct import Examination, VolumeSearch, examine
from needlefit.imaging.reconstruction import EntryChoice, EntryPlace, EntryPose, IntensityProfile, NeedleImage
from needlefit.imaging.scans import Corrections, LayerSource, Scan

FREE = 95.0


def fit_shaft(origin, direction, bend=0.0, turn=0.0, shown=40.0):
    """The pose by a shaft along an axis, held `FREE` mm before the entry, moved and turned at the entry.

    It has the exact deflection of a cantilever whose end is moved by `bend` and turned by `turn`.
    """
    s = np.arange(-shown, 0.0, 0.5)
    x = 1 + s / FREE
    side = np.linalg.svd(np.outer(direction, direction))[0][:, 1]
    deflection = bend * (3 * x**2 - 2 * x**3) + turn * FREE * (x**3 - x**2)
    points = np.asarray(origin) + np.outer(s, direction) + np.outer(deflection, side)
    end = TipFit(s[-1], points[-1], np.zeros(2), np.zeros(3), np.nan)
    needle = Centerline(points, np.full(len(s), 0.005), end)
    scan = Scan("a", Path("a.nrrd"), "box", guide_distance=FREE)
    nothing = IntensityProfile(np.empty(0), np.empty(0))
    image = NeedleImage(
        scan=scan, grid=cases.grid(), needle_axis=needle, profile=nothing, passed=(), choice=EntryChoice()
    )
    entry = EntryPlace(arc_length(points)[-1] + 0.5, 0.1)
    return points, pose_from_shaft(image, entry, cases.RECIPE)


def axis(direction):
    return np.asarray(direction) / np.linalg.norm(direction)


def test_an_unbent_shaft_is_its_own_axis_and_the_final_tangent_is_not():
    direction = axis([1.0, 0.2, -0.1])
    _, pose = fit_shaft([3.0, -2.0, 5.0], direction)
    assert pose.origin == approx([3.0, -2.0, 5.0], abs=1e-9)
    assert pose.direction == approx(direction, abs=1e-9)
    assert (pose.source, pose.along_sd) == ("shaft", 0.1)
    # moved by 0.14 mm and turned by 1.3 degrees at the entry, as at 53 mm of depth
    points, pose = fit_shaft([0.0, 0, 0], axis([1.0, 0, 0]), bend=0.14, turn=np.radians(1.3))
    tip = pose.origin + 53.0 * pose.direction
    assert np.linalg.norm(tip - [53.0, 0, 0]) < 0.3  # the tangent at the entry would miss by 1.2 mm
    along_chord = points[-1] + 53.0 * axis(points[-1] - points[0])
    assert np.linalg.norm(along_chord - [53.0, 0, 0]) > 2 * np.linalg.norm(tip - [53.0, 0, 0])
    fit_shaft([0.0, 0, 0], axis([1.0, 0, 0]), shown=6.5)
    fault = refusal(DataError, r"\b4\.5 mm .*shaft", fit_shaft, [0.0, 0, 0], axis([1.0, 0, 0]), shown=6.0)
    assert "state the stage" in fault.fix


def pose(origin=(0.0, 0, 0), direction=(1.0, 0, 0), shift_sd=0.3, angle_sd=0.02):
    return EntryPose(np.array(origin), axis(direction), "stage", shift_sd, angle_sd, 0.1)


@pytest.mark.parametrize(
    ("origin", "direction", "match"),
    [
        ((29.2, 0, 0), (1.0, 0, 0), r"-49\.2 .* -0\.2 mm"),  # the needle ends before it
        ((0.0, 0, 0), (-1.0, 0, 0), r"20\.0 .* -29\.0 mm"),
        ((0.0, 30, 0), (1.0, 0, 0), r"30\.0 mm beside"),
    ],
)
def test_a_stage_in_another_frame_is_noticed(origin, direction, match):
    needle = np.column_stack([np.arange(-20.0, 30.0), np.zeros(50), np.zeros(50)])
    assert "frame" in refusal(DataError, match, find_first_contact, needle, pose(origin, direction)).fix
    turning_back = np.vstack([needle, needle[:30:-1], needle])
    assert find_first_contact(turning_back, pose((15.0, 0, 0))) == approx(35.0)


def test_stage_and_shaft_are_compared_across_the_axis_and_refused_where_they_differ():
    stage = pose(shift_sd=0.4)  # of both 0.5 mm and 0.028 rad; 7 mm along the axis do not count
    assert not [*compare_poses(stage, pose((7.0, 1.4, 0.0), (1.0, 0.0, 0.08)))]
    for shaft in (pose((7.0, 0.96, 1.28)), pose(direction=(1.0, 0.0, 0.09))):
        assert len([*compare_poses(stage, shaft)]) == 1
    for shaft in (pose((0.0, 5.0, 0)), pose(direction=(1.0, 0.4, 0)), pose(direction=(1.0, 0, -0.4))):
        assert "RAS" in refusal(DataError, "", list, compare_poses(pose(), shaft)).fix


# ---- which of several places where soft material begins is the entry

S = np.arange(-60.0, 48.0, 0.5)
TIP = 40.0


def profile(*edges, width=0.5, noise=3.0, seed=1, s=S, start=-1000.0):
    """Brightness that changes at edges (mm, HU behind); it begins with air."""
    around = np.full(len(s), start)
    for at, behind in edges:
        around, start = around + (behind - start) * ndtr((s - at) / width), behind
    return IntensityProfile(s, around + noise * np.random.default_rng(seed).normal(size=len(s)))


def plate(begin, end, level):
    """Edges of a plate in air before tissue that begins at 0."""
    return (begin, level), (end, -1000.0), (0.0, 35.0)


def choose(shown, thickness=None, distance=None):
    return choose_entry(list_materials(shown, TIP), TIP, thickness, distance)


def assert_chosen(choice, at, guide=None, atol=0.1, guide_atol=None):
    assert choice.doubt is None
    (entry,) = choice.entries
    assert_allclose(entry.at, at, atol=atol)
    if guide is not None:
        assert_allclose(entry.guide, guide, atol=guide_atol or atol)


def test_a_plate_is_passed_by_its_stated_thickness_and_asked_for_where_it_is_not_stated():
    for gap in [2.0, 3.0, 6.0, 11.0]:
        choice = choose(profile(*plate(-8.0 - gap, -gap, 110.0), width=0.7), thickness=8.0)
        assert_chosen(choice, 0.0, atol=min(0.15, 3 * choice.entries[0].sd))
    shown = profile(*plate(-19.0, -11.0, 110.0))
    for thickness in (None, 14.0):
        choice = choose(shown, thickness=thickness)
        assert choice.doubt.where == "guide.thickness_mm"
        assert_allclose([one.at for one in choice.entries], [0.0, -19.0], atol=0.1)
        assert "1: 40.0" in choice.doubt.what and "2: 59.0" in choice.doubt.what
    assert_chosen(choose(shown, thickness=0.0), -19.0)


@pytest.mark.parametrize(
    ("level", "is_tissue"), [(-120, True), (80, True), (-200, False), (120, False), (360, False)]
)
def test_a_first_material_unlike_tissue_may_be_a_guide_that_lies_on_it(level, is_tissue):
    shown = profile((-12.0, level), (0.0, 0.0))
    choice = choose(shown)
    assert_allclose(choice.entries[0].at, -12.0 if is_tissue else 0.0, atol=0.1)
    assert (choice.doubt is None) == is_tissue
    assert_chosen(choose(shown, thickness=12.0), 0.0)  # it changes by 50 HU or more there


@pytest.mark.parametrize("film", [0.0, 0.03])
def test_the_end_of_a_guide_that_is_not_stated_is_as_uncertain_as_a_film_of_air_leaves_it(film):
    for shift in np.linspace(0.0, 0.5, 5):
        shown = profile((shift - 6.0, 120.0), (shift - film, -1000.0), (shift, 20.0), width=0.4)
        behind, entry = choose(shown).entries
        assert_allclose([entry.at, behind.guide[0]], shift - 6.0, atol=0.1)
        assert abs(behind.at - shift) < 3 * behind.sd and 0.15 < behind.sd < 0.2


@pytest.mark.parametrize("dip", [0.0, -800.0])
@pytest.mark.parametrize("level", [360.0, 900.0])
def test_a_plate_on_the_tissue_ends_after_its_thickness_and_what_is_stated_of_the_gap(level, dip):
    # a film of air, of which blur leaves a dip, moves the change of brightness
    flush = profile((-8.0, level), (0.0, dip), (0.5, 35.0), (13.0, -5.0))
    choice = choose(flush, thickness=8.0)
    assert_chosen(choice, 0.0, (-8.0, 0.0), atol=0.05)
    assert choice.entries[0].sd > (0.2 if dip else 0.05)  # what is darker than both may be a film
    assert_chosen(choose(flush, thickness=8.0, distance=0.5), 0.5, (-8.0, 0.0), atol=0.05)
    cavity = profile((-8.0, level), (0.0, 35.0), (15.0, -1000.0), (20.0, 35.0))
    assert_chosen(choose(cavity, thickness=8.0), 0.0, atol=0.05)


@pytest.mark.parametrize("shift", np.linspace(0.0, 0.5, 5))
def test_air_as_long_as_two_stations_is_a_gap_wherever_they_stand(shift):
    stations = S * 0.9996  # as of a curve that is not a whole number of stations long
    shown = profile((shift - 13.0, 900.0), (shift - 1.0, -1000.0), (shift, 0.0), s=stations)
    assert_chosen(choose(shown, thickness=12.0), shift, atol=0.15)


@pytest.mark.parametrize(
    "edges",
    [
        ((0.0, 35.0),),  # no guide, or one that looks as the tissue does
        ((0.0, 35.0), (13.0, -5.0)),
        ((-8.0, 110.0), (0.0, 35.0)),  # one of another thickness
        ((0.0, 35.0), (6.2, -5.0)),  # a layer that ends there
        plate(-30.0, -27.0, 950.0),
    ],
)
@pytest.mark.parametrize("thickness", [6.0, 60.0])
def test_a_stated_guide_that_the_scan_does_not_show_is_named(edges, thickness):
    choice = choose(profile(*edges), thickness=thickness)
    assert choice.doubt.where == "guide.thickness_mm" and f"{thickness:g} mm" in choice.doubt.what
    places = [answer.at for answer in choice.entries]
    # behind a guide that looks as the tissue does, if that is before the tip
    hidden = edges[0][0] + thickness if len(edges) < 3 else np.inf
    assert (hidden < TIP) == any(place == approx(hidden, abs=0.1) for place in places)
    hides = hidden < TIP and edges[0][1] == 35.0
    assert places[0] == approx(hidden if hides else 0.0, abs=0.1)


def test_no_answer_lies_beyond_the_tip():
    metal = (-8.0, 2500.0), (0.0, 35.0)
    assert choose(profile(*metal), distance=39.5) == EntryChoice()
    places = [answer.at for answer in choose(profile(*metal), distance=38.5).entries]
    assert places == approx([38.5], abs=0.2)


@pytest.mark.parametrize("level", [-70.0, 110.0, 950.0, 2300.0, 3071.0])
@pytest.mark.parametrize("thickness", [3.0, 8.0, 12.0])
def test_a_guide_of_any_material_is_passed(level, thickness):
    for gap in [2.0, 6.0, 11.0]:
        faces = -gap - thickness, -gap
        choice = choose(profile(*plate(*faces, level)), thickness=thickness)
        assert_chosen(choice, 0.0, faces, atol=0.2, guide_atol=1.0)


@pytest.mark.parametrize(("level", "is_plate"), [(110.0, True), (-70.0, False), (35.0, False)])
def test_a_thin_plate_on_the_tissue_is_passed_if_it_is_unlike_it(level, is_plate):
    choice = choose(profile((-2.0, level), (0.0, 35.0), width=0.4), thickness=2.0)
    places = [answer.at for answer in choice.entries]
    assert places == approx([0.0] if is_plate else [0.0, -2.0], abs=0.1)
    assert (choice.doubt is None) == is_plate


def test_a_guide_that_the_volume_cuts_and_that_lies_on_the_tissue_leaves_no_entry():
    assert choose(profile((0.0, 35.0), s=S[S > -5.0], start=900.0), thickness=12.0) == EntryChoice()


def test_metal_on_the_tissue_is_passed_by_the_thickness_that_it_has():
    edges = (-8.0, 2500.0), (0.0, 35.0)
    assert_chosen(choose(profile(*edges), thickness=8.0), 0.0, (-8.0, 0.0), atol=0.2)
    for stations in (S, S[S > -7.0]):  # the volume begins in it
        (answer,) = choose(profile(*edges, s=stations), thickness=3.0).entries
        assert_allclose(answer.at, 0.0, atol=0.5)
    bright = profile(*plate(-15.9, -2.0, 3071.0))  # looks 1.9 mm longer than it is
    assert_chosen(choose(bright, thickness=12.0), 0.0, atol=0.2)


@pytest.mark.parametrize("top", [3071.0, 12_000.0])
@pytest.mark.parametrize("gap", [0.0, 6.0])
def test_metal_is_passed_by_the_middle_of_its_brightest_part_though_streaks_go_on_beyond_it(top, gap):
    away = np.maximum(np.abs(S + gap + 3.0) - 3.0, 0.0)  # from its faces, 6 mm apart
    tissue = 900.0 * (S >= 0.0) if gap else 0.0  # in the streaks air behind metal is but a dip
    around = np.minimum(12_000.0 * np.exp(-away) + np.where(S < 0, -200.0, 35.0) + tissue, top)
    choice = choose(IntensityProfile(S, around), thickness=6.0)
    assert_chosen(choice, 0.0, (-6.0 - gap, -gap), atol=0.3)


def test_what_is_passed_begins_at_the_entry_that_a_person_confirmed():
    runs = list_materials(profile((0.0, 35.0), (13.0, -5.0)), TIP)
    entry = EntryPlace(6.0, 0.3)
    *_, face, behind, layer = cut_runs(runs, entry)  # as behind a guide that looks as the tissue does
    assert (face, layer) == (replace(runs[1], end=6.0), runs[2])
    assert behind == replace(face, begin=6.0, end=layer.begin, sd=0.3, rise=0.0, behind_air=False)
    air, face, _ = cut_runs(runs, replace(entry, at=1.0))
    assert (air.end, face) == (1.0, replace(runs[1], begin=1.0, sd=0.3))


# ---- by the tissue's own surface, unless the scan itself shows another place


@pytest.mark.sweep
def test_a_surface_far_from_where_tissue_is_seen_is_refused(tmp_path):
    write_volume(cases.scan(cases.axis(curve=(0.0, 3.0))), tmp_path / "small.nrrd")
    mesh = make_sheet("own", (11.0, 11.0, cases.ENTRY[2] + 8.0), (0, 0, 1), 20.0, into=1).to_trimesh()
    own = LayerSource(save_mesh(tmp_path / "own.stl", mesh), into=1)
    scan = Scan("small", tmp_path / "small.nrrd", "box", surfaces=(own,), surfaces_in="scan")
    (one,) = reconstruct_needles(scan, cases.RECIPE)
    assert re.search(r"begins [78]\.\d\d .* own surface", one.error.what)
    assert "state the stage" in one.error.fix


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("before_tip", "words"), [(-2.0, r"\b(1\.9|2\.\d) mm beyond"), (0.8, r"0\.\d+ mm before"), (4.0, "")]
)
def test_a_contact_lies_before_the_tip(before_tip, words):
    placed = np.array([11.0, 11.0, 40.0 - before_tip])
    scan = Scan("one", Path("one.nrrd"), "box", corrections={"one": Corrections(entry=placed)})
    search = VolumeSearch(cases.scan(cases.axis()), cases.RECIPE)
    if words:
        assert re.search(words, refusal(DataError, "", examine, Examination(scan), search).what)
    else:
        assert examine(Examination(scan), search).depth == approx(before_tip, abs=0.15)
