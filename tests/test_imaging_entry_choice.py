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


def test_a_plate_before_air_is_no_tissue_and_a_narrow_gap_a_gap():
    for width in [0.4, 1.2]:
        choice = choose(profile(*PLATE, *FACE, width=width))
        assert abs(choice.chosen.at) < 0.1
        assert_allclose([one.depth for one in choice.candidates], [59.0, 40.0], atol=0.15)
        assert len(choice.warnings) == 1
    for gap in [2.0, 3.0, 6.0]:
        shown = profile((-8.0 - gap, -1000.0, 110.0), (-gap, 110.0, -1000.0), *FACE, width=0.7)
        choice = choose(shown, thickness=8.0)
        assert abs(choice.chosen.at) < 0.15
        assert abs(choice.chosen.at) < 3 * choice.chosen.sd
        assert choice.warnings == ()
    shown = profile(*PLATE, *FACE)
    choice = choose(shown, thickness=8.0, distance=11.0)
    assert abs(choice.chosen.at) < 0.1
    assert choice.warnings == ()
    assert len(choose(shown, thickness=8.0, distance=20.0).warnings) == 1  # of another rig
    assert len(choose(shown, thickness=14.0).warnings) == 1  # no such plate
    choice = choose(profile(*PLATE, *FACE), thickness=0.0)
    assert_allclose(choice.chosen.at, -19.0, atol=0.1)
    assert choice.warnings == ()


def test_the_stated_length_names_the_candidate():
    for depth, at in [(37.0, 0.0), (62.0, -19.0)]:
        choice = choose(profile(*PLATE, *FACE), depth=depth)
        assert_allclose(choice.chosen.at, at, atol=0.1)
        assert choice.warnings == ()
    shown = profile(*PLATE, *FACE)
    assert len(choose(shown, depth=48.0).warnings) == 1
    with pytest.raises(DataError) as refused:
        choose(shown, depth=20.0)
    assert refused.value.where == "expected_depth_mm"


FLUSH = profile((-8.0, -1000.0, 110.0), (0.0, 110.0, 35.0), (13.0, 35.0, -5.0))


def test_a_plate_that_lies_on_the_tissue_or_does_not_show_is_a_doubt():
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
    assert choose(FLUSH, explained=[0.3]).warnings == ()
    assert len(choose(FLUSH, explained=[13.0]).warnings) == 1
    shown = profile(*FACE)
    choice = choose(shown, thickness=8.0)
    assert_allclose(choice.chosen.at, 8.0, atol=0.1)
    assert len(choice.warnings) == 1
    assert_allclose(choose(shown, thickness=8.0, distance=30.0).chosen.at, 0.0, atol=0.1)


def test_candidates_are_rises_and_steps_before_the_tip_and_no_metal():
    shown = profile((-55.0, 110.0, -1000.0), *FACE)
    assert len(choose(shown).warnings) == 1
    choice = choose(shown, thickness=8.0)
    assert abs(choice.chosen.at) < 0.1
    assert choice.warnings == ()
    shown = profile((-24.0, -1000.0, 2500.0), (-16.0, 2500.0, -1000.0), *FACE)
    assert [run.kind for run in find_runs(shown)] == ["air", "metal", "air", "soft"]
    assert_allclose([at for _, at, _ in find_rises(shown)], [0.0], atol=0.1)
    shown = profile((0.0, -1000.0, 35.0), (30.0, 35.0, -1000.0), (44.0, -1000.0, 35.0))
    assert_allclose([one.at for one in list_candidates(shown, TIP)], [0.0], atol=0.1)
    assert [one.change for one in list_candidates(FLUSH, TIP)] == ["rise", "step", "step"]
    shown = profile(*FACE)
    shown.around[:] += np.where(S > 0, -0.4 * S, 0)
    assert [one.change for one in list_candidates(shown, TIP)] == ["rise"]
    assert choose(profile((0.0, 35.0, 35.0))) is None
