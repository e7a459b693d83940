"""What is suspicious in a dataset: mistakes that a user may make in own data, by kind, file and line."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pytest import approx
from test_datasets import CURVE, X, record, row

from needlefit.datasets.bend_sides import measure_bends
from needlefit.datasets.planes import measure_out_of_plane
from needlefit.datasets.read import check, inspect, read
from needlefit.datasets.scatter import measure_scatter
from needlefit.datasets.write import write_dataset as write_curves
from needlefit.geometry.curves import arc_length
from needlefit.geometry.surfaces import Surface, make_sheet
from needlefit.project.locate import find_file
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load
from needlefit.reporting.dataset_import import explain_unclear
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Inputs, Settings
from needlefit.studies.load import load_study

NOISE = {"registration_mean_mm": 0.1, "point_sd_mm": 0.02}
UP = np.array([0.0, 1.0, 0.0])


def write_dataset(folder, record, rows, curves, surfaces, **options) -> Path:
    """Write curves that are no copies of one another: with noise but at their ends, beside the last."""
    random, beside = np.random.default_rng(1), {}
    for n, (id_, curve) in enumerate(curves.items()):
        noise = np.zeros(curve.shape)
        noise[1:-1, 1:3] = random.normal(0.0, 0.02, (len(curve) - 2, 2))
        beside[id_] = curve + noise + np.eye(curve.shape[1])[2] * 2e-2 * n
    return write_curves(folder, record, rows, beside, surfaces, **options)


def gel(folder: Path, sides=(1, 1, -1), **changes) -> Path:
    """Write three needles that bend toward +y by 1 mm; `sides` are those that their bevels face."""
    bevels = [UP, UP, -UP]
    rows = [
        row(name, "gel", layers=1, bevel=bevel, side=side)
        for name, bevel, side in zip("abc", bevels, sides, strict=True)
    ]
    tables = {"media": {"gel": {}}, "noise": NOISE} | changes
    return write_dataset(folder, record(**tables), rows, dict.fromkeys("abc", CURVE), {}, checksums=False)


def write_rows(folder: Path, *rows, curves=None, noise=NOISE, gel=(), **tables) -> Path:
    """Write needles with these rows into `gel`, all of the same curve where none are given."""
    tables = {"media": {"gel": dict(gel)}, "noise": noise} | tables
    curves = curves or {one.id: CURVE for one in rows}
    return write_dataset(folder, record(**tables), rows, curves, {}, checksums=False)


def into_gel(name="a", **changes):
    return row(name, "gel", **({"layers": 1, "bevel": UP} | changes))


FREE = {"entry": None, "direction": None, "pose_source": "none", "bevel": None}


def find_warnings(path: Path) -> list[ResultWarning]:
    """Return the warnings of a dataset without faults."""
    found = inspect(path)
    assert not found.faults
    return list(found.warnings)


def kinds(path: Path) -> list[str]:
    return [one.kind for one in find_warnings(path)]


def edit(file: Path, pattern: str, new: str) -> int:
    """Replace a line of a file; return its number."""
    lines = file.read_text().split("\n")
    (n,) = [n for n, line in enumerate(lines) if re.search(pattern, line)]
    lines[n] = new
    file.write_text("\n".join(lines))
    return n + 1


def test_no_shipped_dataset_gives_a_warning_and_a_study_names_those_of_units_and_bevels(tmp_path):
    for name in ["twin", "stereo_shapes", "guided_tips"]:
        found = inspect(find_file("dataset", name))
        assert not found.warnings and (name != "twin" or not found.faults)
    notes = []
    file = find_file("fit", "phantom1")
    dataset = read(find_file("dataset", "twin"))
    turned = replace(
        dataset, warnings=(ResultWarning("bevel_side", "all turned"), ResultWarning("noise", "x"))
    )
    settings = Settings(file=file, note=notes.append, inputs=Inputs(dataset=turned))
    load_study("phantom1", load(file, FitRecord), settings)
    assert notes == ["warning: all turned (needlefit explain bevel-side)"]


def test_what_a_bend_that_is_not_clear_was_compared_with_is_stated(tmp_path):
    assert explain_unclear(read(gel(tmp_path / "clear"))) == ""
    dataset = read(write_rows(tmp_path / "straight", into_gel(), curves={"a": CURVE * [1, 0.01, 1]}))
    (bend,) = measure_bends(dataset.insertions, dataset.noise)
    assert not (bend.is_toward or bend.is_away) and 0.05 < bend.limit_mm < 0.5
    text = explain_unclear(dataset)
    assert f"{bend.limit_mm:.2g} mm" in text and "--set bevel_side=-1" in text


def test_insertions_deflected_away_from_their_bevel_are_named(tmp_path):
    assert kinds(gel(tmp_path / "right")) == []
    (one,) = inspect(gel(tmp_path / "one", (1, -1, -1))).warnings
    assert one.kind == "bevel_side" and ": b (" in one.what and one.where.endswith("insertions.csv:3")
    (every,) = inspect(gel(tmp_path / "all", (-1, -1, 1))).warnings
    assert "all 3" in every.what and "flipped" in every.fix and "`bevel_side`" in every.fix
    assert read(tmp_path / "all").warnings == (every,)  # every fit reads the same


@pytest.mark.parametrize(
    ("pattern", "line", "right"),
    [
        ("outer_diameter", "outer_diameter_mm = 0.00127", "1.27"),
        ("outer_diameter", "outer_diameter_mm = 0.05", "1.27"),
        ("outer_diameter", "outer_diameter_mm = 0.635", "1.27"),
        ("outer_diameter", "outer_diameter_mm = 18", "mm"),
        ("youngs_modulus", "youngs_modulus_gpa = 0.08", "GPa"),
        ("outer_diameter", "flexural_rigidity_nmm2 = 0.0102", "10200"),
        ("point_sd_mm", "point_sd_mm = 4e-5", "0.04"),
        ("point_sd_mm", "point_sd_mm = 4", "mm"),
    ],
)
def test_a_value_in_another_unit_is_named_with_its_place(tmp_path, pattern, line, right):
    file = gel(tmp_path)
    edit(file, pattern, line)
    if "rigidity" in line:
        edit(file, "youngs_modulus", "")
    (one,) = inspect(file).warnings
    assert (
        one.where.startswith(f"{file}, key ") and right in one.fix and f"`{line.split()[0]}`" not in one.what
    )
    assert line.split()[0] in one.what + one.fix or one.kind == "noise"


def test_a_depth_in_another_unit_than_its_curve_is_named_with_the_line_of_its_row(tmp_path):
    for factor, unit in [(0.1, "centimetres"), (1 / 25.4, "inches")]:
        file = gel(tmp_path)
        table = file.parent / "insertions.csv"
        table.write_text(table.read_text().replace("50.0000", f"{50 * factor:.6g}"))
        assert {one.where: unit in one.what and "depth_mm" in one.what for one in check(file)} == {
            f"{table}:{line}": True for line in (2, 3, 4)
        }
    file = gel(tmp_path)
    edit(file, "insertions.csv", 'file = "insertions.csv"\ncolumns = { depth_mm = "Tiefe" }')
    table = file.parent / "insertions.csv"
    table.write_text(table.read_text().replace("depth_mm", "Tiefe", 1).replace("50.0000", "0.05"))
    faults = check(file)
    assert len(faults) == 3
    assert all(
        "Tiefe" in one.what and "metres" in one.what and one.where.startswith(str(table)) for one in faults
    )


@pytest.mark.parametrize(
    ("key", "wrong", "right"),
    [
        ("registration_mean_mm", (178, 1.78e-4), (0.9,)),
        ("correlation_length_mm", (151,), (0.5, 150)),
    ],
)
def test_a_stated_error_that_cannot_be_right_is_named_with_its_place(tmp_path, key, wrong, right):
    for value in (*wrong, *right):
        file = gel(tmp_path, noise=NOISE | {"correlated_sd_mm": 0.02, "correlation_length_mm": 5.0})
        edit(file, key, f"{key} = {value}")
        warnings = find_warnings(file)
        assert [one.where for one in warnings] == [f"{file}, key `noise.{key}`"] * (value in wrong)
        assert all(key in one.what for one in warnings)


@pytest.mark.parametrize(("degrees", "count"), [(5.0, 0), (500.0, 1)])
def test_a_roll_of_which_nothing_is_known_is_named(tmp_path, degrees, count):
    path = write_rows(tmp_path, into_gel(roll=0.0, roll_sd=np.radians(degrees)))
    found = [one for one in find_warnings(path) if "bevel_roll_sd_deg" in one.what]
    assert [one.kind for one in found] == ["units"] * count


@pytest.mark.parametrize(
    ("boundaries", "count"),
    [
        *[([0.025], 1), ([2.5e4], 1), ([0.5], 0), ([25.0], 0)],  # metres, micrometres
        *[([1.0, 3.0], 1), ([2.0, 20.0], 0)],  # all of them at the top
        *[([20.0, 55.0], 1), ([20.0, 49.0], 0)],  # below every insertion
        *[([20.0, 20.01], 1), ([20.0, 20.5], 0)],  # nearly one
    ],
)
def test_boundaries_that_no_tissue_has_are_named_with_their_place(tmp_path, boundaries, count):
    one = into_gel(layers=1 + sum(depth < 50 for depth in boundaries))
    file = write_rows(tmp_path, one, gel={"boundaries_mm": boundaries})
    warnings = inspect(file).warnings
    places = [("units", f"{file}, key `media.gel.boundaries_mm`")] * count
    assert [(one.kind, one.where) for one in warnings] == places
    assert all(f"{boundaries[-1]:g}" in one.what for one in warnings)


def test_own_boundaries_that_no_tissue_has_are_named_once_with_their_row(tmp_path):
    rows = [into_gel("a", layers=2, boundaries=(20.0,)), into_gel("b", layers=1, boundaries=())]
    rows += [into_gel(name, layers=2, boundaries=(0.025,)) for name in "cd"]
    curves = {one.id: CURVE * [1, 1 + 0.2 * n, 1] for n, one in enumerate(rows)}
    file = write_rows(tmp_path, *rows, curves=curves)
    (found,) = inspect(file).warnings
    assert (found.kind, found.where) == ("units", f"{tmp_path / 'insertions.csv'}:4")
    assert "`boundaries_mm` is 0.025" in found.what and "2 of 4 rows" in found.what


def test_data_without_any_error_or_point_are_a_fault(tmp_path):
    assert kinds(gel(tmp_path, noise={})) == ["no_noise"]
    edit(tmp_path / "dataset.toml", "^correlation_length", "correlation_length_mm = 1e9")
    (fault,) = check(tmp_path)
    assert "correlation_length_mm" in fault.what and fault.where == str(tmp_path / "dataset.toml")
    curves = {"a": np.column_stack([CURVE, np.where(X > 0, 0.1, 0.0)])}
    for name, noise, count in (("none", {}, 1), ("some", {"point_sd_mm": 0.02}, 0)):
        file = write_rows(tmp_path / name, into_gel(), curves=curves, noise=noise)
        assert [one.where for one in check(file)] == [f"{file.parent / 'insertions.csv'}:2"] * count
    edit(file, "^point_sd_mm", "point_sd_mm = 1e-9")
    assert "point_sd_mm" in check(file)[0].what
    frame = {"pose": "free", "drop_proximal_mm": 60.0}
    file = write_rows(tmp_path, into_gel(**FREE), frame=frame)
    (fault,) = check(file)
    assert fault.where == f"{file}, key `frame.drop_proximal_mm`"


def layered(folder: Path, surfaces, files=None, layers=2) -> Path:
    listed = [{"file": file, "kind": "sheet", "into": n} for n, file in enumerate(files or surfaces, start=2)]
    rows = [row(name, "gel", layers=layers, bevel=UP) for name in "ab"]
    tables = record(media={"gel": {"surfaces": listed}}, noise=NOISE)
    return write_dataset(folder, tables, rows, dict.fromkeys("ab", CURVE), surfaces, checksums=False)


def plane(x: float):
    return make_sheet("sheet", (x, 0, 0), (1, 0, 0), 120, into=2)


def test_surfaces_listed_twice_missed_or_out_of_order_are_named(tmp_path):
    once = layered(tmp_path / "once", {"layers/a.stl": plane(20)})
    assert check(once) == []
    (twice,) = check(layered(tmp_path / "name", {"layers/a.stl": plane(20)}, ["layers/a.stl"] * 2, 3))
    assert "layers/a.stl" in twice.what and twice.where.startswith(str(tmp_path / "name/dataset.toml"))
    missed = check(layered(tmp_path / "turned", {"layers/a.stl": plane(-20)}))
    assert ["RAS" in one.fix for one in missed] == [True, True]
    assert kinds(layered(tmp_path / "one", {"layers/a.stl": plane(70)}, layers=1)) == ["surfaces"]
    both = {"layers/a.stl": plane(20), "layers/b.stl": plane(40)}
    assert kinds(layered(tmp_path / "order", both, layers=3)) == []
    (turned,) = find_warnings(layered(tmp_path / "swapped", both, [*both][::-1], layers=3))
    assert turned.kind == "surfaces" and "3 > 2" in turned.what


@pytest.mark.parametrize("pose", ["known", "free"])
def test_curves_that_begin_at_the_tip_are_named(tmp_path, pose):
    """Three needles into one block, from the entry to the tip and the other way round."""
    for turned in (False, True):
        curves = {name: CURVE[: len(CURVE) - 8 * n][:: -1 if turned else 1] for n, name in enumerate("abc")}
        rows = []
        for name, curve in curves.items():
            known = {"entry": curve[0], "direction": np.eye(3)[0] * (-1 if turned else 1)}
            depth = float(arc_length(curve)[-1])
            rows.append(into_gel(name, depth=depth, **(known if pose == "known" else FREE)))
        frame = {"name": "frame", "pose": pose}
        path = write_rows(tmp_path / str(turned), *rows, curves=curves, frame=frame)
        assert ("reversed" in kinds(path)) == turned


@pytest.mark.parametrize("turn", [0.0, 35.0])
def test_tips_out_of_the_planes_of_their_bevels_come_with_the_direction_that_fits(tmp_path, turn):
    """Three needles bend by 3 mm; the stated bevels are turned away from them about the entry direction."""
    tilt = np.radians(turn)
    curve = np.column_stack([X, 12e-4 * X**2 * np.cos(tilt), 12e-4 * X**2 * np.sin(tilt)])
    rows = [into_gel(name, bevel=UP) for name in "abc"]
    path = write_rows(tmp_path, *rows, curves=dict.fromkeys("abc", curve))
    found = [one for one in find_warnings(path) if one.kind == "bevel_plane"]
    away = {name: mm for name, mm, _ in measure_out_of_plane(read(path))}
    assert away["a"] == approx(3.0 * np.sin(tilt), abs=1e-3)
    assert len(found) == (turn > 0)
    for one in found:  # the roll of each, then the direction of all
        *_, x, y, z = (float(number) for number in re.findall(r"-?\d\.\d+", one.fix))
        assert [x, y, z] == approx([0.0, np.cos(tilt), np.sin(tilt)], abs=0.02) and "35 (a)" in one.fix


@pytest.mark.parametrize("twist", [0.0, 1.0])
def test_free_shapes_that_bend_in_no_plane_are_named(tmp_path, twist):
    """Two needles that bend by 20 mm, and from the middle on across that plane."""
    turned = np.clip(X - 25.0, 0.0, None)
    curve = np.column_stack([X, 8e-3 * (X**2 - twist * turned**2), twist * 8e-3 * turned**2])
    rows = [into_gel(name, **FREE) for name in "ab"]
    tables = {"frame": {"name": "free", "pose": "free"}}
    path = write_rows(tmp_path, *rows, curves=dict.fromkeys("ab", curve), **tables)
    assert ("bevel_plane" in kinds(path)) == bool(twist)
    assert len(measure_out_of_plane(read(path))) == 2


def test_surfaces_that_insertions_begin_within_and_never_meet_have_a_hole(tmp_path):
    """A box without the face where the needles enter, and the same box elsewhere."""
    box = trimesh.creation.box(extents=(80, 60, 60))
    box.apply_translation((40.0, 0.0, 0.0))
    box.update_faces(box.face_normals[:, 0] > -0.5)
    for shift, words in ((0.0, "hole"), (300.0, "frame")):
        mesh = box.copy().apply_translation((0.0, shift, 0.0))
        folder = tmp_path / words
        medium = {"surfaces": [{"file": "skin.stl", "kind": "sheet", "into": 2}]}
        surface = Surface("skin", mesh.vertices, mesh.faces, "sheet", 2)
        tables = {"media": {"gel": medium}, "noise": NOISE}
        write_dataset(folder, record(**tables), [into_gel()], {"a": CURVE}, {"skin.stl": surface})
        (found,) = (one for one in find_warnings(folder) if one.kind == "surfaces")
        assert words in found.fix


def test_curves_with_the_points_of_another_one_are_copies(tmp_path):
    """Exported again without points; and measured twice."""
    random = np.random.default_rng(11)
    once, twice = (CURVE + random.normal(0.0, 0.02, CURVE.shape) * [0, 1, 1] for _ in range(2))
    others = {
        "dropped": np.delete(once, 40, axis=0),
        "every third": once[::3],
        "twice": twice,
    }
    for name, curve in others.items():
        rows = [into_gel("a"), into_gel("b")]
        tables = record(media={"gel": {}}, noise=NOISE)
        path = write_curves(tmp_path / name, tables, rows, {"a": once, "b": curve}, {})
        copies = [(one.insertions, one.where) for one in find_warnings(path) if one.kind == "copy"]
        assert copies == [(("b", "a"), f"{path.parent}/insertions.csv:3")] * (name != "twice")


@pytest.mark.parametrize(("factor", "count"), [(0.01, 1), (0.05, 1), (0.4, 1), (1, 0), (2.5, 0), (10, 1)])
@pytest.mark.parametrize("is_flat", [False, True])
def test_points_that_scatter_more_or_less_than_their_stated_noise_contradict_it(
    tmp_path, factor, count, is_flat
):
    """The noise that is stated is a multiple of what the points have: 0.04 mm."""
    random = np.random.default_rng(3)
    across = [0, 1, 0] if is_flat else [0, 1, 1]
    curves = {name: CURVE[::2] + random.normal(0.0, 0.04, (51, 3)) * across for name in "ab"}
    path = write_curves(
        tmp_path,
        record(media={"gel": {}}, noise={"point_sd_mm": 0.04 * factor}),
        [into_gel("a"), into_gel("b")],
        curves,
        {},
    )
    assert sum(one.kind in ("noise", "units") for one in find_warnings(path)) == count
    assert measure_scatter(read(path).insertions[0]) == approx(0.04, rel=0.25)


def test_names_that_differ_by_case_alone_are_faults(tmp_path):
    """Two specimens would count as independent, and two centrelines be one file on some systems."""
    for folder, rows in (
        ("same", [into_gel("a", specimen="gel"), into_gel("b", specimen="gel")]),
        ("specimen", [into_gel("a", specimen="gel"), into_gel("b", specimen="Gel")]),
        ("id", [into_gel("a", specimen="gel"), into_gel("A", specimen="gel")]),
    ):
        found = check(write_rows(tmp_path / folder, *rows))
        assert [one.where.endswith("insertions.csv:3") for one in found] == [True] * (folder != "same")


def test_errors_that_points_share_leave_little_error_of_each(tmp_path):
    noise = {"point_sd_mm": 0.0003, "correlated_sd_mm": 0.003, "correlation_length_mm": 4.0}
    path = write_curves(tmp_path, record(media={"gel": {}}, noise=noise), [into_gel()], {"a": CURVE}, {})
    assert not [one for one in find_warnings(path) if one.kind == "units"]


def test_insertions_in_inches_are_named(tmp_path):
    tables = record(media={"gel": {}}, noise={"point_sd_mm": 0.02})
    path = write_curves(tmp_path, tables, [into_gel(depth=50 / 25.4)], {"a": CURVE / 25.4}, {})
    (found,) = (one for one in find_warnings(path) if one.kind == "units")
    assert "25.4" in found.fix
    tables = record(media={"gel": {"boundaries_mm": [20.0]}}, noise={"point_sd_mm": 0.02})
    row = into_gel(depth=50 / 25.4, layers=2)
    (fault,) = check(write_curves(tmp_path / "layers", tables, [row], {"a": CURVE / 25.4}, {}))
    assert "25.4" in fault.fix
