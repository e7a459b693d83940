"""One bad point, one bad needle, all needles alike wrong, and sound ones: what a dataset is warned of."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from inference_cases import insertion
from scipy.spatial.transform import Rotation
from test_datasets import record, row

from needlefit.datasets.comparison import Deviation, expect
from needlefit.datasets.insertion import Noise
from needlefit.datasets.layers import ListedInsertion
from needlefit.datasets.needles import describe_rigidity
from needlefit.datasets.outlying_needles import _join_evidence, compare_bends, compare_scatters, find_ends
from needlefit.datasets.points import Points, find_rounding
from needlefit.datasets.read import inspect
from needlefit.datasets.write import write_dataset
from needlefit.geometry.neighbours import find_steps, leave_last_out, leave_one_out
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.scene import NeedleRecord
from needlefit.studies.advice import classify_doubt, list_contradictions
from needlefit.studies.judge import limit_status

UP, POINT_SD, SHIFT_SD, ANGLE_SD_DEG = np.array([0.0, 1.0, 0.0]), 0.05, 0.05, 0.1
SIDES = (-1, 1, -1, 1, -1, 1, -1, 1)


def measure_needles(seed, sides=SIDES, sd=POINT_SD, bend=1.0):
    """Return needles (N, 3), 35 to 70 mm deep in steps of 5 mm, that bend toward their bevels by id."""
    rng, found = np.random.default_rng(seed), {}
    for n, side in enumerate(sides):
        x = np.arange(0.0, 36.0 + 5.0 * n, 5.0)
        toward = bend * 1.5e-3 * np.exp(0.1 * rng.normal()) * x**2
        across = np.radians(ANGLE_SD_DEG) * rng.normal(size=2) * x[:, None] + SHIFT_SD * rng.normal(size=2)
        points = np.column_stack([x, side * toward + across[:, 0], across[:, 1]])
        found[f"n{n + 1}"] = points + [0, sd, sd] * rng.normal(size=points.shape)
    return found


def write_needles(folder: Path, curves, sides=SIDES, step=0.0, sd=POINT_SD, depths=None) -> Path:
    """Write needles into one medium, each into another specimen, rounded to a step; return the file."""
    rows = []
    for (name, curve), side in zip(curves.items(), sides, strict=True):
        curves = curves | {name: np.round(curve / step) * step if step else curve}
        depth = float(np.linalg.norm(np.diff(curves[name], axis=0), axis=1).sum())
        depth = depth if depths is None else depths[name]
        pose = {"entry": np.zeros(3), "pose_shift_sd": SHIFT_SD, "pose_angle_sd": np.radians(ANGLE_SD_DEG)}
        rows.append(row(name, "gel", layers=1, bevel=UP, side=side, depth=depth, specimen=name, **pose))
    tables = record(media={"gel": {}}, noise={"point_sd_mm": sd})
    return write_dataset(folder, tables, rows, curves, {}, checksums=False)


def find_warnings(folder: Path, curves, *options, **named) -> list[ResultWarning]:
    """Return the warnings about needles that are written with these options."""
    found = inspect(write_needles(folder, curves, *options, **named))
    assert not found.faults
    return list(found.warnings)


def move(*vector):
    return lambda points: points + np.array(vector)


@pytest.mark.parametrize("seed", range(12))
def test_sound_needles_give_no_warning(tmp_path, seed):
    assert find_warnings(tmp_path, measure_needles(seed)) == []


@pytest.mark.parametrize(
    ("index", "change", "words", "off_mm"),
    [
        (4, move(0, 2, 0), ": y is", 2.0),
        (5, move(0, 0, -2), ": z is", 2.0),
        (-3, lambda point: point * [1, 0, 1], "empty cell", 4.0),
        (-1, move(0, 1, 0), "the tip", 1.0),
        (0, move(0, 0, 1), "the first point", 1.0),
        (6, move(2, 0, 0), ": x is", 2.0),
        (-3, move(-2, 0, 0), ": x is", 2.0),
    ],
)
def test_a_point_off_its_curve_is_named_with_its_row_and_alone(tmp_path, index, change, words, off_mm):
    curves = measure_needles(1)
    curves["n6"][index] = change(curves["n6"][index])
    (one,) = find_warnings(tmp_path, curves)
    line = 2 + index % len(curves["n6"])
    assert (one.kind, one.where) == ("point_outlier", f"{tmp_path}/centerlines/n6.csv:{line}")
    assert "n6" in one.what and words in one.what
    assert float(re.search(r"([\d.]+) mm off", one.what)[1]) == pytest.approx(off_mm, abs=0.3)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("entry_offset", move(0, 20 * SHIFT_SD, 0)),
        ("entry_offset", move(0, 0, 20 * SHIFT_SD)),
        ("needle_outlier", lambda points: points * [1, 3, 1]),
        ("needle_outlier", lambda points: points * [1, 0.1, 1]),
        ("needle_outlier", Rotation.from_euler("y", 3, degrees=True).apply),
        ("bevel_side", lambda points: points * [1, -1, 1]),
    ],
)
def test_a_needle_unlike_its_entry_or_the_others_is_named(tmp_path, kind, change):
    curves = measure_needles(2)
    curves["n5"] = change(curves["n5"])
    found = [one for one in find_warnings(tmp_path, curves) if one.kind != "bevel_plane"]
    assert [one.kind for one in found] == [kind] and "n5 " in found[0].what


@pytest.mark.parametrize("vector", [(0, 1, 0), (0, 0, -1), (0, 0.8, 0.8)])
@pytest.mark.parametrize("first", [3, 6, 9])
def test_a_step_is_named_between_its_points_and_no_neighbour_is(tmp_path, vector, first):
    curves = measure_needles(8)
    curves["n6"][first:] += vector
    (one,) = find_warnings(tmp_path, curves)
    assert (one.kind, one.where) == ("point_outlier", f"{tmp_path}/centerlines/n6.csv:{first + 2}")
    assert f"between points {first} and {first + 1} " in one.what
    assert float(re.search(r"([\d.]+) mm", one.what)[1]) == pytest.approx(np.linalg.norm(vector), abs=0.2)


def test_a_gap_in_the_sampling_is_no_finding(tmp_path):
    curves = measure_needles(9)
    curves["n6"], curves["n7"] = np.delete(curves["n6"], 5, axis=0), curves["n7"][[0, 1, *range(2, 13, 2)]]
    assert find_warnings(tmp_path, curves) == []


@pytest.mark.parametrize("index", [0, -1])
def test_ends_are_compared_with_those_of_the_other_needles(tmp_path, index):
    """Its own cubic leads on to an end with three times the noise of a point: that names none."""
    curves = measure_needles(10, sd=0.1)
    curves["n4"][index] += [0, 0, 1.2]
    (one,) = find_warnings(tmp_path, curves, sd=0.1)
    assert one.kind == "point_outlier" and "n4 " in one.what


@pytest.mark.parametrize("factor", [0.1, 0.2])
def test_bend_and_scatter_together_name_a_straight_needle_in_another_unit(tmp_path, factor):
    curves = measure_needles(11, bend=0.25)
    assert find_warnings(tmp_path / "sound", curves) == []
    curves["n7"] = curves["n7"] * [1, factor, 1]
    found = find_warnings(tmp_path / "made", curves)
    assert [one.kind for one in found] == ["needle_outlier"] and "n7 " in found[0].what


@pytest.mark.parametrize("degrees", [-3, 3])
def test_a_needle_turned_in_its_plane_is_named_by_its_angle(tmp_path, degrees):
    curves = measure_needles(12)
    curves["n4"] = Rotation.from_euler("z", degrees, degrees=True).apply(curves["n4"])
    (one,) = [each for each in find_warnings(tmp_path, curves) if each.kind != "bevel_side"]
    assert one.kind == "needle_outlier" and "n4 " in one.what
    assert float(re.search(r"([\d.]+) degrees", one.what)[1]) == pytest.approx(3, abs=0.6)


DESIGNS = {
    "one deeper, 20 points each": ((50.0,) * 5 + (60.0,), 20),
    "one shallower": ((50.0,) * 7 + (40.0,), 11),
    "of lengths that differ by noise": ((50.0, 50.02, 49.99, 50.01, 50.03, 60.0), 11),
}


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("bend", [0.3, 1.0])
def test_a_needle_of_another_depth_than_all_others_is_not_compared_with_them(tmp_path, design, bend):
    rng, curves = np.random.default_rng(3), {}
    depths, count = DESIGNS[design]
    for n, depth in enumerate(depths):
        x, side = np.linspace(0.0, depth, count), SIDES[n]
        points = np.column_stack([x, side * bend * 1.5e-3 * x**2, np.zeros(count)])
        curves[f"n{n + 1}"] = points + [0, POINT_SD, POINT_SD] * rng.normal(size=points.shape)
    assert find_warnings(tmp_path, curves, SIDES[: len(depths)]) == []


@pytest.mark.parametrize(("deepest", "is_compared"), [(70.0, False), (59.0, True)])
def test_beyond_their_own_range_the_others_lead_to_expect_nothing(deepest, is_compared):
    logs = np.log([50.0, 52.0, 54.0, 55.0, deepest])
    design = np.column_stack([np.ones(5), logs - logs.mean()])
    found = expect(4, design, 2 * logs, np.full(5, 1e-4), 0.1)
    assert (found is not None) == is_compared
    assert found is None or found.value == pytest.approx(2 * logs[4])


def test_of_few_needles_none_is_compared_with_the_others(tmp_path):
    curves = {name: curve for name, curve in measure_needles(2).items() if name < "n5"}
    curves["n3"] = curves["n3"] * [1, 2, 1]
    assert find_warnings(tmp_path, curves, SIDES[:4]) == []


@pytest.mark.parametrize(
    ("size", "unit", "change"),
    [
        (3.0, "mm", move(0, 3, 0)),
        (3.0, "mm", move(0, 0, -3)),
        (3.0, "mm", move(3, 0, 0)),
        (2.0, "degrees", Rotation.from_euler("z", 2, degrees=True).apply),
        (2.0, "degrees", Rotation.from_euler("y", 2, degrees=True).apply),
    ],
)
def test_what_all_needles_share_whichever_way_their_bevels_face_is_named_once(tmp_path, size, unit, change):
    curves = {name: change(curve) for name, curve in measure_needles(3).items()}
    (one,) = find_warnings(tmp_path, curves)
    assert one.kind == "common_pose"
    assert float(re.search(rf"([\d.]+) {unit}", one.what)[1]) == pytest.approx(size, rel=0.1)


def test_a_lean_toward_bevels_that_all_face_one_way_is_their_bend(tmp_path):
    sides = (1,) * 8
    turned = Rotation.from_euler("z", 2, degrees=True)
    curves = {name: turned.apply(curve) for name, curve in measure_needles(3, sides).items()}
    assert find_warnings(tmp_path, curves, sides) == []


def test_what_others_lead_to_expect_is_their_mean_with_its_error():
    """Of 1, 2, 3, 4 with an error variance of 1/4 and a natural one of 1/4, by hand."""
    values, ones = np.array([1.0, 2.0, 3.0, 4.0, 9.0]), np.ones((5, 1))
    found = expect(4, ones, values, np.full(5, 0.25), 0.5)
    assert found is not None
    # scatter 5/3 on 3 degrees of freedom; spread (8 / 4 + 3 (5/3 - 1/4)) / 11 = 25/44
    assert (found.value, found.sure) == (2.5, 11)
    assert found.variance == pytest.approx(25 / 44 + (1 / 4 + 25 / 44) / 4)
    assert found.natural_variance == pytest.approx(5 / 4 * 25 / 44)


@pytest.mark.parametrize(("count", "free"), [(5, 2), (6, 2), (7, 2), (12, 7)])
def test_the_curve_of_a_needle_leaves_degrees_of_freedom(count, free):
    x = np.linspace(0.0, 40.0, count)
    points = np.column_stack([x, 2e-3 * x**2, np.zeros(count)])
    one = insertion(40.0).with_points(points)
    listed = ListedInsertion(one, None, "", Points(Path(), one.frame.to_world(points)))
    found = find_ends(listed, Noise(point_sd=0.05))
    assert found.free == free and found.bend == pytest.approx(one.side * points[-1, 1])


def make_ends(bend, scatter, across=0.0):
    """Return what `compare_bends` reads of a needle whose variances out of its plane are `across`."""
    variance = np.array([0.01, across])
    return SimpleNamespace(bend=bend, entry_variance=variance, tip_variance=variance, scatter=scatter, free=5)


def test_bends_are_compared_by_errors_in_the_plane_alone():
    bends, flat = (1.0, 1.1, 0.9, 1.05, 4.0), np.zeros(2)
    a, b = (
        compare_bends([make_ends(one, flat, across) for one in bends], np.ones((5, 1))) for across in (0, 1e6)
    )
    assert a == b and [one.is_beyond for one in a] == [False] * 4 + [True]


def test_scatters_are_compared_by_fisher_s_distribution():
    scatters = np.array([[1.0, 1.0], [1.0, 1.0], [4.0, 1.0]])
    found = compare_scatters([make_ends(1.0, one) for one in scatters])
    # over that out of the plane, beside the others' pooled ratios: 5/2, 5/2 and 1
    np.testing.assert_allclose(found, scipy.stats.f.cdf([0.4, 0.4, 4.0], 5, 5))


@pytest.mark.parametrize(("value", "less"), [(0.5, 0.99), (-0.5, 0.01)])
def test_a_bend_and_a_scatter_are_joined_by_fisher_s_method(value, less):
    both = scipy.stats.combine_pvalues([1e-3, 0.01]).pvalue
    found = _join_evidence(Deviation(value, 3.2, 1e-3), less)
    assert (found.chance, found.sds) == pytest.approx((both, scipy.stats.norm.isf(both / 2)))


@pytest.mark.parametrize("factor", [0.1, 5.0])
def test_an_axis_in_another_unit_is_named_by_its_scatter(tmp_path, factor):
    curves = {name: curve * [1, factor, 1] for name, curve in measure_needles(4).items()}
    found = [one for one in find_warnings(tmp_path, curves) if one.kind == "axis_unit"]
    assert len(found) == 1 and "along y" in found[0].what
    times = float(re.search(r"([\d.]+) times too large", found[0].fix)[1])
    assert times == pytest.approx(factor, rel=0.6)


@pytest.mark.parametrize("step", [0.1, 0.5, 1.0])
def test_rounded_needles_are_no_copies_and_a_copy_is_one(tmp_path, step):
    curves = measure_needles(5)
    sd = np.hypot(POINT_SD, step / np.sqrt(12))
    assert "copy" not in [one.kind for one in find_warnings(tmp_path / "all", curves, SIDES, step, sd)]
    curves["n5"] = curves["n7"].copy()
    found = [one for one in find_warnings(tmp_path / "fine", curves, SIDES, 0.01) if one.kind == "copy"]
    assert len(found) == 1 and "n7 and n5" in found[0].what


def test_rounding_is_found_from_coordinates():
    points = np.array([[0.0, 0.5, 0.0], [5.0, 1.5, 0.0], [10.0, 2.0, 0.0]])
    assert [find_rounding([factor * points]) for factor in (1.0, 2.0, 0.1, 0.12)] == [0.5, 1.0, 0.05, 0.02]
    assert find_rounding([np.pi * points]) == 0.0


def test_points_of_a_cubic_are_predicted_by_their_neighbours():
    x = np.linspace(0.0, 10.0, 11)
    left, factor = leave_one_out(x, np.column_stack([x**3, 1 - x]))
    np.testing.assert_allclose(left, 0.0, atol=1e-9)
    rng = np.random.default_rng(6)
    drawn, _ = leave_one_out(x, rng.normal(size=(11, 4000)))
    np.testing.assert_allclose(drawn.std(axis=1), factor, rtol=0.05)


def test_steps_and_ends_of_polynomials_are_found_with_their_errors():
    x = np.linspace(0.0, 10.0, 11)
    smooth = np.column_stack([x**2, 1 - x])
    left, factor = leave_last_out(x, smooth + np.outer(x == x[-1], [0.0, 2.0]))
    np.testing.assert_allclose(left, [0.0, 2.0], atol=1e-9)
    assert leave_last_out(x, np.random.default_rng(7).normal(size=(11, 4000)))[0].std() == pytest.approx(
        factor, rel=0.05
    )
    steps, factors = find_steps(x, smooth + np.outer(x > x[5], [3.0, 0.0]))
    np.testing.assert_allclose(steps[5], [3.0, 0.0], atol=1e-9)
    drawn, _ = find_steps(x, np.random.default_rng(8).normal(size=(11, 4000)))
    np.testing.assert_allclose(drawn[1:-1].std(axis=1), factors[1:-1], rtol=0.05)
    assert not np.isfinite(factors[[0, -1]]).any()


def test_a_verdict_on_data_that_contradict_themselves_does_not_pass():
    def make(*kinds):
        return type("Result", (), {"warnings": [ResultWarning(kind, "") for kind in kinds]})()

    found = [ResultWarning(kind, "") for kind in ("placeholder", "needle_outlier", "point_outlier")]
    assert list_contradictions(found) == ["point_outlier"]
    doubts = ["result_doubtful", "dataset_doubtful"]  # a needle is named by a fit, a point before it
    assert list(map(classify_doubt, found[1:])) == doubts
    assert {limit_status(make("copy"), one) for one in ("pass", "warn", "fail")} == {"warn"}
    assert limit_status(make("noise"), "pass") == "pass"


def test_the_values_behind_a_rigidity_stand_with_their_origins():
    needle = NeedleRecord(length_mm=150.0, outer_diameter_mm=0.908, youngs_modulus_gpa=60.0)
    assert describe_rigidity(needle, ()) == "diameter 0.908 mm, solid, 60 GPa from dataset.toml"
    assert "60 GPa assumed" in describe_rigidity(needle, {"modulus"})
    stated = NeedleRecord(length_mm=150.0, flexural_rigidity_nmm2=2000.0)
    assert describe_rigidity(stated, ()) == "stated in dataset.toml"


@pytest.mark.parametrize(("value", "step", "named"), [(0.0, 0.0, True), (1.0, 0.0, True), (0.0, 1.0, False)])
def test_a_needle_with_one_value_where_others_vary_is_named(tmp_path, value, step, named):
    """Where coordinates are rounded by more than their noise, those of a straight needle may be equal."""
    curves = measure_needles(3)
    if step:
        curves = {name: curve * [1.0, 0.05, 0.05] for name, curve in curves.items()}
    curves["n4"][:, 1] = value
    found = [one.what for one in find_warnings(tmp_path, curves, step=step) if "at all points" in one.what]
    assert [what.partition(":")[0] for what in found] == ["n4"] * named


def swap(first, second):
    return lambda curves: curves | {first: curves[second], second: curves[first]}


@pytest.mark.parametrize(
    ("change", "named", "cause"),
    [
        (lambda curves: {name: 1.1 * one for name, one in curves.items()}, 8, "1.1 times as long"),
        (lambda curves: {name: 1.03 * one for name, one in curves.items()}, 8, "1.03 times as long"),
        (swap("n3", "n6"), 2, "n3 is as long as n6 is deep"),
        (lambda curves: curves | {"n4": curves["n4"][1:]}, 1, "along the entry direction"),
        (lambda curves: curves | {"n4": 1.1 * curves["n4"]}, 1, "too small"),
        (lambda curves: curves | {"n4": 1.03 * curves["n4"]}, 1, "too small"),
        (lambda curves: curves | {"n4": curves["n4"][:-3]}, 1, "last points may be missing"),
    ],
)
def test_a_length_that_differs_from_its_depth_is_named_with_what_explains_it(tmp_path, change, named, cause):
    curves = measure_needles(5, sd=0.02)
    depths = {name: float(np.linalg.norm(np.diff(one, axis=0), axis=1).sum()) for name, one in curves.items()}
    found = inspect(write_needles(tmp_path, change(curves), depths=depths, sd=0.02))
    texts = [one.what for one in found.faults]
    if not texts:
        texts = [one.what for one in found.warnings if one.kind == "length"]
        assert len(re.findall(r"n\d", texts[0].partition(":")[0])) == named
    assert cause in texts[0] and len(texts) in (1, named)
