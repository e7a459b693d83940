"""One bad point, one bad needle, all needles alike wrong, and sound ones: what is known before a fit."""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx
from scipy.interpolate import CubicSpline
from test_datasets import record, row

from needlefit.datasets.points import find_rounding
from needlefit.datasets.read import inspect
from needlefit.datasets.record_warnings import find_spellings
from needlefit.datasets.scatter import count_independent
from needlefit.datasets.write import write_dataset
from needlefit.geometry.neighbours import leave_one_out
from needlefit.inference.likelihood.observations.points import POINTS
from needlefit.inference.likelihood.stated_errors import StatedErrors
from needlefit.project.result_warnings import ResultWarning
from needlefit.studies.first_page import classify_doubt, list_contradictions

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
        (4, move(0, 2, 0), "along y", 2.0),
        (5, move(0, 0, -2), "along z", -2.0),
        (-3, lambda point: point * [1, 0, 1], "along y", -4.0),
        (-1, move(0, 1.5, 0), "the tip", 1.5),
        (0, move(0, 0, 1.5), "the first point", 1.5),
    ],
)
def test_a_point_off_its_curve_is_named_with_its_row_and_alone(tmp_path, index, change, words, off_mm):
    curves = measure_needles(1)
    curves["n6"][index] = change(curves["n6"][index])
    (one,) = find_warnings(tmp_path, curves)
    line = 2 + index % len(curves["n6"])
    assert (one.kind, one.where) == ("point_outlier", f"{tmp_path}/centerlines/n6.csv:{line}")
    assert "n6" in one.what and words in one.what
    assert float(re.search(r"by ([-+\d.]+) mm", one.what)[1]) == approx(off_mm, abs=0.3)


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_no_needle_is_compared_with_the_others(tmp_path, factor):
    curves = measure_needles(2)
    curves["n5"] = curves["n5"] * [1, factor, 1]
    assert find_warnings(tmp_path, curves) == []


def test_a_gap_in_the_sampling_is_no_finding(tmp_path):
    curves = measure_needles(9)
    curves["n6"], curves["n7"] = np.delete(curves["n6"], 5, axis=0), curves["n7"][[0, 1, *range(2, 13, 2)]]
    assert find_warnings(tmp_path, curves) == []


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


@pytest.mark.parametrize("vector", [(3, 0, 0), (0, 0, -3)])
def test_needles_that_all_begin_off_their_entries_are_named_with_the_distance(tmp_path, vector):
    curves = {name: move(*vector)(curve) for name, curve in measure_needles(3).items()}
    (one,) = [each for each in find_warnings(tmp_path, curves) if each.kind == "entry_offset"]
    numbers = [float(text) for text in re.findall(r"-?\d\.\d(?=, | mm)", one.what)]
    assert np.mean(np.reshape(numbers, (8, 3)), axis=0)[[0, 2]] == approx([vector[0], vector[2]], abs=0.1)


@pytest.mark.parametrize("factor", [0.1, 5.0])
def test_an_axis_in_another_unit_is_named_by_its_scatter(tmp_path, factor):
    curves = {name: curve * [1, factor, 1] for name, curve in measure_needles(4).items()}
    found = [one for one in find_warnings(tmp_path, curves) if one.kind == "axis_unit"]
    assert len(found) == 1 and "along y" in found[0].what
    scatter = float(re.search(r"([\d.]+) mm along y", found[0].what)[1])
    assert scatter == approx(factor * POINT_SD, rel=0.6)


@pytest.mark.parametrize("step", [0.1, 0.5, 1.0])
def test_rounded_needles_are_no_copies_and_a_copy_is_one(tmp_path, step):
    curves = measure_needles(5)
    sd = np.hypot(POINT_SD, step / np.sqrt(12))
    assert find_warnings(tmp_path / "all", curves, SIDES, step, sd) == []
    curves["n5"] = curves["n7"].copy()
    found = [one for one in find_warnings(tmp_path / "fine", curves, SIDES, 0.01) if one.kind == "copy"]
    assert len(found) == 1 and "n7 and n5" in found[0].what
    pasted = measure_needles(5)
    count = min(len(pasted["n5"]), len(pasted["n7"]))
    pasted["n5"][:count, 1] = pasted["n7"][:count, 1]
    found = [one for one in find_warnings(tmp_path / "y", pasted, SIDES, 0.01) if one.kind == "copy"]
    assert [one.insertions for one in found] == [("n7", "n5")] and f"y at {count}" in found[0].what
    again = curves | {"n5": curves["n7"] + np.random.default_rng(7).normal(0, POINT_SD, curves["n7"].shape)}
    found = find_warnings(tmp_path / "again", again, SIDES, 0.01)
    assert [one.insertions for one in found if one.kind == "copy"] == [("n7", "n5")]


def test_rounding_is_found_from_coordinates():
    points = np.array([[0.0, 0.5, 0.0], [5.0, 1.5, 0.0], [10.0, 2.0, 0.0]])
    assert [find_rounding([factor * points]) for factor in (1.0, 2.0, 0.1, 0.12)] == [0.5, 1.0, 0.05, 0.02]
    assert find_rounding([np.pi * points]) == 0.0


def test_points_of_a_cubic_are_predicted_by_their_neighbours():
    x = np.linspace(0.0, 10.0, 11)
    left, factor = leave_one_out(x, np.column_stack([x**3, 1 - x]))
    assert_allclose(left, 0.0, atol=1e-9)
    rng = np.random.default_rng(6)
    drawn, _ = leave_one_out(x, rng.normal(size=(11, 4000)))
    assert_allclose(drawn.std(axis=1), factor, rtol=0.05)


def test_contradictions_of_needles_that_are_left_out_do_not_count():
    kinds = ("placeholder", "needle_outlier", "point_outlier", "copy")
    found = [ResultWarning(kind, "", insertions=("n1", "n2") * (kind == "copy")) for kind in kinds]
    assert list_contradictions(found) == list_contradictions(found, ["n1"]) == ["copy"]
    assert list_contradictions(found, ["n3", "n2", "n1"]) == []
    assert list_contradictions([ResultWarning("bevel_side", "")], ["n1"]) == ["bevel_side"]
    # a needle is named by a fit, a point before it
    doubts = ["result_doubtful", "dataset_doubtful", "dataset_doubtful"]
    assert list(map(classify_doubt, found[1:])) == doubts


@pytest.mark.parametrize(("value", "step", "named"), [(0.0, 0.0, True), (1.0, 0.0, True), (0.0, 1.0, False)])
def test_a_needle_with_one_value_where_others_vary_is_named(tmp_path, value, step, named):
    """Where coordinates are rounded by more than their noise, those of a straight needle may be equal."""
    curves = measure_needles(3)
    if step:
        curves = {name: curve * [1.0, 0.05, 0.05] for name, curve in curves.items()}
    curves["n4"][:, 1] = value
    found = [one.what for one in find_warnings(tmp_path, curves, step=step) if "at all points" in one.what]
    assert [what.partition(":")[0] for what in found] == ["n4"] * named


@pytest.mark.parametrize("interpolate", [np.interp, lambda at, x, y: CubicSpline(x, y)(at)])
def test_points_interpolated_between_few_count_as_these(tmp_path, interpolate):
    curves = measure_needles(6)
    for name in ("n4", "n7"):
        few = curves[name][np.linspace(0, len(curves[name]) - 1, 6).round().astype(int)]
        at = np.linspace(0.0, few[-1, 0], 100)
        curves[name] = np.column_stack([interpolate(at, few[:, 0], axis) for axis in few.T])
    found = inspect(write_needles(tmp_path, curves))
    assert [one.kind for one in found.warnings] == ["interpolated"]
    counts = {one.id: one.independent for one in found.dataset.insertions}
    assert {name for name, count in counts.items() if count} == {"n4", "n7"}
    assert all(6 <= counts[name] <= 12 for name in ("n4", "n7"))
    for one in found.dataset.insertions:  # errors of the mean of all points
        points = POINTS.observe(one, StatedErrors(found.dataset, found.dataset.noise))
        variance = np.diag(points.point_covariance).mean() / len(points.measured)
        assert variance == approx(POINT_SD**2 / (counts[one.id] or len(one.points)), rel=0.05)


@pytest.mark.parametrize(("stated", "least"), [(1.0, 200), (4.0, 197)])
def test_independent_points_are_all_counted(stated, least):
    """Also where the stated SD is too large."""
    rng, x = np.random.default_rng(12), np.linspace(0.0, 60.0, 30)
    line, errors = np.column_stack([x, 1.5e-3 * x**2, 0 * x]), [0, POINT_SD, POINT_SD]
    curves = [line + errors * rng.normal(size=(30, 3)) for _ in range(200)]
    assert sum(count_independent(curve, stated * POINT_SD) == 30 for curve in curves) >= least


@pytest.mark.parametrize(
    ("names", "count"),
    [
        (("gel", "gle"), 1),
        (("chicken", "chiken", "pork"), 1),
        (("pork-1", "Pork 1"), 1),
        (("phantom1", "phantom2"), 0),
        (("gel 5 %", "gel 10 %", "soft gel", "stiff gel"), 0),
        (("pva", "pvc", "pork a", "pork b", "gel"), 0),
    ],
)
def test_one_name_in_two_spellings_is_found(names, count):
    assert len([*find_spellings(names)]) == count
