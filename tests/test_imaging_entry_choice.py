"""Which of several places where soft material begins is the entry: profiles with known edges."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

from needlefit.errors import DataError
from needlefit.imaging.entry import EntryKnowledge, choose_entry, list_candidates
from needlefit.imaging.materials import find_rises, find_runs
from needlefit.imaging.reconstruction import IntensityProfile

S = np.arange(-60.0, 48.0, 0.5)
TIP = 40.0
PLATE = ((-19.0, -1000.0, 110.0), (-11.0, 110.0, -1000.0))
FACE = ((0.0, -1000.0, 35.0),)


def profile(*edges, width=0.5, noise=3.0, seed=1):
    """A profile with edges (mm, HU before, HU behind) of a needle that ends at `TIP`."""
    around = np.full(len(S), edges[0][1])
    for at, before, behind in edges:
        around = around + (behind - before) * ndtr((S - at) / width)
    around += noise * np.random.default_rng(seed).normal(size=len(S))
    return IntensityProfile(S, np.where(S <= TIP, 3000.0, 35.0), around)


def choose(shown, depth=None, thickness=None, distance=None, explained=()):
    return choose_entry(shown, TIP, EntryKnowledge(depth, thickness, distance, np.array(explained)))


@pytest.mark.parametrize("width", [0.4, 1.2])
def test_a_plate_before_air_is_no_tissue_and_is_named(width):
    choice = choose(profile(*PLATE, *FACE, width=width))
    assert abs(choice.chosen.at) < 0.1
    assert_allclose([one.depth for one in choice.candidates], [59.0, 40.0], atol=0.15)
    assert len(choice.warnings) == 1


def test_a_stated_plate_leaves_no_doubt():
    shown = profile(*PLATE, *FACE)
    choice = choose(shown, thickness=8.0, distance=11.0)
    assert abs(choice.chosen.at) < 0.1
    assert choice.warnings == ()
    assert len(choose(shown, thickness=8.0, distance=20.0).warnings) == 1  # of another rig
    assert len(choose(shown, thickness=14.0).warnings) == 1  # no such plate


def test_without_a_plate_tissue_may_hold_air():
    choice = choose(profile(*PLATE, *FACE), thickness=0.0)
    assert_allclose(choice.chosen.at, -19.0, atol=0.1)
    assert choice.warnings == ()


@pytest.mark.parametrize(("depth", "at"), [(37.0, 0.0), (62.0, -19.0)])
def test_the_stated_length_names_the_candidate(depth, at):
    choice = choose(profile(*PLATE, *FACE), depth=depth)
    assert_allclose(choice.chosen.at, at, atol=0.1)
    assert choice.warnings == ()


def test_a_stated_length_between_candidates_is_a_doubt_and_one_far_off_an_error():
    shown = profile(*PLATE, *FACE)
    assert len(choose(shown, depth=48.0).warnings) == 1
    with pytest.raises(DataError) as refused:
        choose(shown, depth=20.0)
    assert refused.value.where == "expected_depth_mm"


@pytest.mark.parametrize("gap", [2.0, 3.0, 6.0])
def test_a_narrow_gap_is_a_gap(gap):
    shown = profile((-8.0 - gap, -1000.0, 110.0), (-gap, 110.0, -1000.0), *FACE, width=0.7)
    choice = choose(shown, thickness=8.0)
    assert abs(choice.chosen.at) < 0.15
    assert abs(choice.chosen.at) < 3 * choice.chosen.sd
    assert choice.warnings == ()


FLUSH = profile((-8.0, -1000.0, 110.0), (0.0, 110.0, 35.0), (13.0, 35.0, -5.0))


def test_a_plate_that_lies_on_the_tissue_is_a_doubt_unless_it_is_stated():
    choice = choose(FLUSH)
    assert_allclose(choice.chosen.at, -8.0, atol=0.1)
    assert len(choice.warnings) == 1
    assert 1.0 < choice.chosen.sd < 2.0  # as bright as plastic; layers of gel are not
    gel = choose(profile((-8.0, -1000.0, 60.0), (0.0, 60.0, 20.0)))
    assert len(gel.warnings) == 1 and gel.chosen.sd < 0.1
    stated = choose(FLUSH, thickness=8.0)
    assert_allclose(stated.chosen.at, 0.0, atol=0.15)
    assert stated.warnings == ()
    assert choose(FLUSH, thickness=0.0).warnings == ()


def test_a_step_where_a_stated_layer_ends_is_no_doubt():
    assert choose(FLUSH, explained=[0.3]).warnings == ()
    assert len(choose(FLUSH, explained=[13.0]).warnings) == 1


def test_a_stated_plate_that_does_not_show_is_a_doubt():
    shown = profile(*FACE)
    choice = choose(shown, thickness=8.0)
    assert_allclose(choice.chosen.at, 8.0, atol=0.1)
    assert len(choice.warnings) == 1
    assert_allclose(choose(shown, thickness=8.0, distance=30.0).chosen.at, 0.0, atol=0.1)


def test_a_plate_that_leaves_the_scan_is_a_plate():
    shown = profile((-55.0, 110.0, -1000.0), *FACE)
    assert len(choose(shown).warnings) == 1
    choice = choose(shown, thickness=8.0)
    assert abs(choice.chosen.at) < 0.1
    assert choice.warnings == ()


def test_metal_is_neither_tissue_nor_a_candidate():
    shown = profile((-24.0, -1000.0, 2500.0), (-16.0, 2500.0, -1000.0), *FACE)
    assert [run.kind for run in find_runs(shown)] == ["air", "metal", "air", "soft"]
    assert_allclose([at for _, at, _ in find_rises(shown)], [0.0], atol=0.1)


def test_what_lies_beyond_the_tip_is_no_entry():
    shown = profile((0.0, -1000.0, 35.0), (30.0, 35.0, -1000.0), (44.0, -1000.0, 35.0))
    assert_allclose([one.at for one in list_candidates(shown, TIP)], [0.0], atol=0.1)


def test_layers_are_steps_and_a_slope_is_none():
    assert [one.change for one in list_candidates(FLUSH, TIP)] == ["rise", "step", "step"]
    shown = profile(*FACE)
    shown.around[:] += np.where(S > 0, -0.4 * S, 0)
    assert [one.change for one in list_candidates(shown, TIP)] == ["rise"]


def test_nothing_is_chosen_where_nothing_rises():
    assert choose(profile((0.0, 35.0, 35.0))) is None
