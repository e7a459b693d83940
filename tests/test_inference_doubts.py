"""Needles that the others do not predict: sound ones are not accused, and each mistake has its cause."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import TRUTH, dataset, insertion, measure, medium
from inference_cases import problem as make_problem
from pytest import approx

from needlefit.datasets.insertion import Noise
from needlefit.inference import doubts
from needlefit.inference.doubts import Doubts, find_doubts, find_limit, fit_quickly
from needlefit.inference.hypotheses import Change, Deviation, Explanation, explain, search_sizes

DEPTHS = np.linspace(35.0, 65.0, 7)
POINT_SD = 0.05


def measure_needles(seed: int, spread: float = 0.0):
    """Return needles into two layers, bevels both ways, in specimens whose ln mu has a standard deviation."""
    rng, made = np.random.default_rng(seed), []
    for n, depth in enumerate(DEPTHS):
        planned = replace(insertion(depth, [20.0], [1, 2]), id=f"n{n}", specimen=f"s{n}", side=(-1) ** n)
        values = {name: value * math.exp(spread * rng.normal()) for name, value in TRUTH.items()}
        values |= {name: TRUTH[name] for name in TRUTH if not name.startswith("mu")}
        one = measure(values, medium(), planned)
        across = rng.normal(0, POINT_SD, (len(one.points), 2)) * [1, 0]
        made.append(one.with_points(one.points[:, :2] + across[:, ::-1]))
    return made


def make(made, point_sd=POINT_SD):
    return replace(make_problem(medium(), made), dataset=dataset(made, Noise(point_sd=point_sd)))


def doubt(made, point_sd=POINT_SD):
    problem = make(made, point_sd)
    return find_doubts(problem, problem.parameters.theta(TRUTH)).odd_needles


def change(made, number, by):
    found = list(made)
    found[number] = found[number].with_points(by(found[number].points))
    return found


@pytest.mark.parametrize("spread", [0.0, 0.15])
def test_sound_needles_are_not_accused(spread):
    assert [one for seed in range(4) for one in doubt(measure_needles(seed, spread))] == []
    assert list(doubt(measure_needles(4, spread), 10 * POINT_SD)) == []


def test_a_needle_nearer_than_five_standard_deviations_is_named_if_a_change_is_far_more_probable():
    (one,) = doubt(change(measure_needles(1, 0.15), 3, lambda points: points * [1, 1.35, 1]))
    assert (one.insertion, one.cause, one.sds < 5) == ("n3", "scaled", True)
    assert one.size == approx(1.35, rel=0.1) and one.log_odds > math.log(150)


@pytest.mark.parametrize(
    ("by", "cause", "size"),
    [
        (lambda points: points * [1, -1, 1], "mirrored", None),
        (lambda points: points * [1, 0.3, 1], "scaled", 0.3),
        (lambda points: points * [1, 2.0, 1], "scaled", 2.0),
        (lambda points: points + np.outer(points[:, 0], [0, math.tan(math.radians(3)), 0]), "turned", 3.0),
        (lambda points: points + np.array([0, 2.0, 0]), "shifted", 2.0),
    ],
)
def test_a_needle_is_named_with_what_happened_to_it_and_its_size(by, cause, size):
    (one,) = doubt(change(measure_needles(1), 4, by))
    assert (one.insertion, one.cause) == ("n4", cause) and one.sds > 5
    assert one.size is None if size is None else one.size == approx(size, rel=0.15)
    _, measured, predicted = np.transpose(one.points)
    assert abs(measured - predicted).max() > 5 * POINT_SD


def test_a_step_is_named_with_the_point_where_it_is_and_its_size():
    (one,) = doubt(change(measure_needles(2), 3, lambda points: points + [0, 2.0, 0] * (points[:, :1] > 20)))
    first = 1 + int(np.argmax(measure_needles(2)[3].points[:, 0] > 20))
    assert (one.insertion, one.cause, one.where) == ("n3", "stepped", str(first))
    assert one.size == approx(2.0, rel=0.1)


def test_a_tip_that_alone_is_off_is_named_with_how_far_it_is_off():
    made = measure_needles(3)
    made[4] = made[4].with_points(made[4].points + [0, 1.0, 0] * (made[4].points == made[4].points[-1]))
    (needle,) = doubt(made)
    assert (needle.insertion, needle.cause, needle.where) == ("n4", "tip_off", str(len(made[4].points)))
    assert needle.size == approx(1.0, abs=5 * needle.sd) and needle.sd < 0.2


def test_needles_whose_points_were_exchanged_are_named_with_each_other():
    made = [*measure_needles(4), *(replace(one, id=f"m{one.id}") for one in measure_needles(5))]
    made[2], made[5] = made[2].with_points(made[5].points), made[5].with_points(made[2].points)
    found = {(one.insertion, one.cause, one.where) for one in doubt(made)}
    assert found == {("n2", "of_another", "n5"), ("n5", "of_another", "n2")}


@pytest.mark.parametrize(
    ("peak", "gain", "is_clear"), [(1.0, 9.5, False), (1.0, 10.0, True), (3.0, 100.0, False)]
)
def test_a_change_is_clear_if_it_is_150_times_as_probable_as_none_and_its_size_is_within_the_range(
    peak, gain, is_clear
):
    def measure(sizes):
        return [Deviation(0.0, gain * (1 - (size / peak - 1) ** 2)) for size in sizes]

    change = Change("shifted", starts=(-2.0, 0.0, 2.0), cost=math.log(100.0))
    found = explain([change], lambda change: search_sizes(measure, change.starts), 0.0)
    assert found.is_clear == is_clear and found.size == approx(min(peak, 2.0))


def test_a_boundary_is_not_clear_where_another_one_explains_as_much_by_what_cannot_be():
    found = {"1": Deviation(math.inf, 16.0), "2": Deviation(0.0, 12.0)}

    def search(change):
        return {0.0: Deviation(0.0, 0.0), 5.0: found[change.where]}, 1.0

    first, second = (Change("boundary", where=number, starts=(0.0, 5.0)) for number in found)
    assert explain([second], search, 0.0).is_clear
    assert not explain([first, second], search, 0.0).is_clear


@pytest.mark.parametrize(("sd", "is_named"), [(0.8, True), (4.0, True), (4.4, False)])
def test_a_boundary_is_named_from_three_standard_deviations_on(monkeypatch, sd, is_named):
    problem = make(measure_needles(7))
    (change,) = doubts.list_boundary_shifts(problem)
    found = Explanation(change, 12.6, sd, 0.0, 20.0, is_clear=True)
    monkeypatch.setattr(doubts, "explain", lambda *_: found)
    named = doubts.find_common(problem, problem.parameters.theta(TRUTH))
    assert (named is not None) == is_named


def test_a_needle_with_another_boundary_is_named():
    made = measure_needles(6)
    made[5] = replace(made[5], boundaries=made[5].boundaries + 12.0)
    (one,) = doubt(made)
    assert (one.insertion, one.cause, one.where) == ("n5", "boundary", "1")
    assert one.size == approx(-12.0, abs=2.0)


def test_a_needle_that_no_change_explains_is_named_without_a_cause():
    wave = np.sin(np.linspace(0, 12, 101))
    (one,) = doubt(change(measure_needles(2), 3, lambda points: points + np.outer(wave, [0, 0.5, 0])))
    assert (one.insertion, one.cause, one.size) == ("n3", "", None)


def test_where_more_than_a_quarter_deviate_none_is_accused():
    made = measure_needles(3)
    for number in (1, 3, 5):
        made = change(made, number, lambda points: points * [1, -1, 1])
    problem = make(made)
    theta = fit_quickly(problem)
    found = find_doubts(problem, theta)
    assert found.odd_needles == () and found.deviating in [(n, 7) for n in range(3, 8)]
    assert all(find_doubts(make(measure_needles(seed)), theta).deviating is None for seed in range(3))


@pytest.mark.parametrize(
    ("by", "cause", "size"),
    [
        (lambda points: points + np.outer(points[:, 0], [0, math.tan(math.radians(2)), 0]), "turned", 2.0),
        (lambda points: points + np.array([0, 1.0, 0]), "shifted", 1.0),
    ],
)
def test_what_happened_to_all_needles_alike_is_named_with_its_size_and_none_is_accused(by, cause, size):
    made = measure_needles(1)
    for number in range(len(made)):
        made = change(made, number, by)
    problem = make(made)
    found = find_doubts(problem, fit_quickly(problem))
    assert list(found.odd_needles) == [] and found.deviating is None and found.common_doubt is not None
    assert found.common_doubt.cause == cause and found.common_doubt.size == approx(
        size, abs=3 * found.common_doubt.sd
    )
    made[2] = made[2].with_points(made[2].points * [1, -1, 1])
    beside = find_doubts(make(made), problem.parameters.theta(TRUTH)).common_doubt
    assert beside.cause == cause and beside.size == approx(size, abs=3 * beside.sd)


def test_a_guide_that_gave_way_toward_the_bevels_is_no_boundary_elsewhere():
    made = [one.with_points(one.points + np.array([0, 0.3 * one.side, 0])) for one in measure_needles(8)]
    problem = make(made)
    found = find_doubts(problem, fit_quickly(problem))
    assert list(found.odd_needles) == [] and found.common_doubt is None


def test_bevels_that_all_face_one_way_do_not_tell_a_turn_of_all_from_an_error_of_the_model():
    made = [replace(one, side=1).with_points(one.points * [1, one.side, 1]) for one in measure_needles(1)]
    turned = [one.with_points(one.points + np.outer(one.points[:, 0], [0, 0.03, 0])) for one in made]
    problem = make(turned)
    assert find_doubts(problem, fit_quickly(problem)).common_doubt is None


def test_a_boundary_that_is_stated_in_centimetres_is_found_if_the_noise_is_known():
    made = [replace(one, boundaries=np.array([2.0])) for one in measure_needles(7)]
    problem = make(made)
    theta = fit_quickly(problem)
    common = find_doubts(problem, theta).common_doubt
    assert (common.cause, common.where, common.stated) == ("boundary", "1", 2.0)
    assert common.size == approx(18.0, abs=1.0)
    likelihood = problem.likelihood.model_copy(update={"noise_scale": "estimated"})
    assert find_doubts(replace(problem, likelihood=likelihood), theta).common_doubt is None


def test_three_needles_needles_off_their_plane_and_needles_without_stated_noise_are_not_judged():
    made = change(measure_needles(1), 1, lambda points: points * [1, -1, 1])
    bent = change(made, 3, lambda points: points + points[:, :1] ** 2 * [0, 0, 0.001])
    assert len(doubt(made)) == 1
    silent = replace(make_problem(medium(), made), dataset=dataset(made, Noise()))
    for problem, reason in ((make(made[:3]), "few"), (make(bent), "plane"), (silent, "noise")):
        assert find_doubts(problem) == Doubts(unjudged=reason)


def test_of_more_needles_one_must_be_farther_to_be_named():
    assert [find_limit(count) for count in (1, 8, 500)] == approx([5.0, 5.386, 6.088], abs=1e-3)
