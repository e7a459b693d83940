"""Files are read as a mapping states them: layouts, missing values, joined tables, contradictions."""

import json

import numpy as np
import pandas as pd
import pytest
from import_cases import (
    curves_of,
    needle,
    planned,
    prepare,
    write_european_csv,
    write_long,
    write_placed,
    write_rows,
    write_sheets,
)
from numpy.testing import assert_allclose
from refusals import refusal
from test_cli import run

from needlefit.datasets.importing.prepare import WORKBOOK_FILE, prepare_import
from needlefit.datasets.importing.read import integrate_angles
from needlefit.datasets.importing.tables import read_sheets
from needlefit.datasets.read import inspect, read
from needlefit.errors import ConfigError, DataError
from needlefit.project.locate import read_toml
from needlefit.studies.first_page import CONTRADICTIONS

NEEDLES = [needle(n, 16) for n in range(3)]


def assert_read(paths, wanted=NEEDLES, names=None, **stated):
    curves, draft = curves_of(paths, **stated)
    assert names is None or [*curves] == names
    assert len(curves) == len(wanted)
    for curve, points in zip(curves.values(), wanted, strict=True):
        assert_allclose(curve.line, points, atol=1e-3)
    return draft


def long_rows(head=("needle", "x", "y", "z"), number=str):
    return [[*head], *([f"n{k}", *map(number, point)] for k, one in enumerate(NEEDLES, 1) for point in one)]


# ---- layouts of tables


@pytest.mark.parametrize("kind", ["message", "markers", "named"])
def test_all_points_of_a_needle_may_stand_in_a_row(tmp_path, kind):
    curves = [one[:12] for one in NEEDLES]
    path = "/needle/shape/poses[{}]/position/"
    heads = {
        "message": [["__time", *(path.format(n) + axis for n in range(12) for axis in "xyz")]],
        "markers": [
            ["Format Version", 1.23],
            ["", "", *(f"needle:Marker {n:03}" for n in range(12) for _ in range(3))],
            ["", "", *(["Position"] * 36)],
            ["Frame", "Time (Seconds)", *("XYZ" * 12)],
        ],
        "named": [["needle", "bevel side", *(f"{axis}{n}" for n in range(1, 13) for axis in "xyz")]],
    }[kind]
    before = {"message": [[0.1], [0.2], [0.3]], "markers": [[1, 0.1], [2, 0.2], [3, 0.3]]}
    before |= {"named": [["a", 1], ["b", -1], ["c", 1]]}
    rows = [*heads, *([*own, *one.ravel()] for own, one in zip(before[kind], curves, strict=True))]
    file = write_rows(tmp_path / "a.csv", rows)
    assert "--set layout=wide" in refusal(DataError, "", prepare, [file]).fix
    assert_read([file], curves, layout="wide")
    if kind == "named":
        plan = prepare([file], layout="wide").plan
        assert [(row.id, row.side) for row in plan.rows] == [("a", 1), ("b", -1), ("c", 1)]


def test_tables_of_other_programs(tmp_path):
    """R's write.table, numpy's savetxt, thousands, cm beside mm, a header with a remark."""
    rows = long_rows(number=lambda value: f"{value:.6f}")
    text = "\n".join(
        " ".join([f'"{n}"', f'"{name}"', *point]) for n, (name, *point) in enumerate(rows[1:], 1)
    )
    (tmp_path / "r.txt").write_text('"needle" "x" "y" "z"\n' + text)
    assert_read([tmp_path / "r.txt"])
    body = "\n".join(" ".join(f"{value:.6f}" for value in point) for point in NEEDLES[0])
    (tmp_path / "s.txt").write_text(f"# x y z [mm]\n{body}")
    assert_read([tmp_path / "s.txt"], NEEDLES[:1])
    mixed = [[name, f"{float(x) / 10:.7f}", y, z] for name, x, y, z in rows[1:]]
    assert_read([write_rows(tmp_path / "c.csv", [["needle", "x [cm]", "y (down) [mm]", "z [mm]"], *mixed])])


def test_a_table_of_slicer_is_in_ras_and_its_labels_name_needles(tmp_path):
    rows = [["label", "r", "a", "s", "defined", "selected", "visible"]]
    for n, one in enumerate(NEEDLES, 1):
        rows += [[f"N{n}-{k}", -x, -y, z, 1, 1, 1] for k, (x, y, z) in enumerate(one, 1)]
    assert_read([write_rows(tmp_path / "a.csv", rows)], names=["N1", "N2", "N3"])
    rows = [rows[0], *([f"F-{n}", *row[1:]] for n, row in enumerate(rows[1:17], 1))]
    file = write_rows(tmp_path / "a.csv", rows)
    assert "--set holds=shapes" in refusal(DataError, "", prepare, [file]).fix
    assert_read([file], NEEDLES[:1], holds="shapes")


def test_names_of_any_script_and_cells_with_line_breaks_are_kept(tmp_path):
    names = ["针一", "针二", "Игла"]
    rows = [[names[k], *point] for k, one in enumerate(NEEDLES) for point in one]
    file = write_rows(tmp_path / "a.csv", [["needle", "x", "y", "z"], *rows])
    assert_read([file], names=names)
    assert [one.id for one in read(write_placed(tmp_path / "gel", [file])).insertions] == names
    quoted = ['"needle\nname",x,y,z', *(",".join(map(str, row)) for row in rows)]
    file.write_text("\n".join(quoted), encoding="utf-8")
    assert_read([file], names=names)
    assert prepare([file]).content.curves[0].points.lines[0] == 3
    quoted[20] = f'"{quoted[20]}'  # on line 22, as the first row has two
    file.write_text("\n".join(quoted), encoding="utf-8")
    assert refusal(DataError, "", prepare, [file]).where.endswith("a.csv:22")


@pytest.mark.parametrize("count", [3, 8])
def test_a_label_in_the_first_row_of_a_block_is_filled_down(tmp_path, count):
    needles = [needle(n) for n in range(count)]
    rows = [
        [f"V{k}" if n == 0 else "", *point] for k, one in enumerate(needles) for n, point in enumerate(one)
    ]
    file = write_rows(tmp_path / "a.csv", [["Nadel", "x", "y", "z"], *rows])
    draft = assert_read([file], needles, names=[f"V{k}" for k in range(count)])
    assert (draft.tables[0]["fill_down"], draft.tables[0]["holds"]) == (["Nadel"], "shapes")
    assert "fill_down" in draft.assumed
    rows = [[f"P{n}" if n != 7 else "", *point] for n, point in enumerate(needles[0])]  # a label is lacking
    file = write_rows(tmp_path / "b.csv", [["Nadel", "x", "y", "z"], *rows])
    assert "fill_down" not in assert_read([file], needles[:1], holds="shapes").tables[0]


def test_tips_beside_shapes_are_needles_of_one_dataset(tmp_path):
    rows = [[f"n{n}", *point] for n, one in enumerate(NEEDLES, 1) for point in one - one[0]]
    rows, tips = [["needle", "x", "y", "z"], *rows], [["n4", 50, 2, 0.5], ["n5", 60, -3, 0]]
    stated = {"pose": "1,0,0", "bevel": "0,1,0", "unit": "mm"}
    one = write_rows(tmp_path / "a.csv", [*rows, *tips])
    two = [write_rows(tmp_path / "b.csv", rows), write_rows(tmp_path / "c.csv", [rows[0], *tips])]
    for files in ([one], two):
        folder = write_placed(tmp_path / f"{len(files)}", files, **stated)
        data = inspect(folder).dataset
        assert [one.id for one in data.insertions] == ["n1", "n2", "n3", "n4", "n5"]
        assert len([*(folder / "centerlines").iterdir()]) == 3
        table = pd.read_csv(folder / "insertions.csv").set_index("id").loc[["n4", "n5"]]
        assert table[["depth_mm", "tip_y_mm", "tip_z_mm"]].to_numpy().tolist() == [[50, 2, 0.5], [60, -3, 0]]
    assert "n4, n5" in refusal(DataError, "--set pose", prepare, [one], unit="mm").what
    cut = write_rows(tmp_path / "f.csv", [*rows, ["n6", "", "", ""], ["n6", 50, 2, 0], ["n6", "", 1, 0]])
    refusal(DataError, "n6 has one point", prepare, [cut], **stated)
    far = write_rows(tmp_path / "e.csv", [*long_rows(), *tips])  # n3 begins 6 mm from the origin
    refusal(DataError, "--set entry_point", prepare, [far], **stated)
    alone = write_rows(tmp_path / "d.csv", [rows[0], *tips])
    assert [row.depth for row in prepare([alone], **stated).plan.rows] == [
        50,
        60,
    ]


# ---- missing values


@pytest.mark.parametrize("text", ["nan", "NA", "-", "", "-999"])
def test_points_that_were_not_measured_are_left_out_as_the_mapping_states(tmp_path, text):
    rows = long_rows()
    rows[5][2] = rows[25][2] = text
    file = write_rows(tmp_path / "a.csv", rows)
    prepared = prepare([file])
    assert [len(one.line) for one in prepared.content.curves] == [15, 15, 16]
    assert "missing" in prepared.mapping.assumed and len(prepared.content.left_out) == 2


# ---- tables joined on needle or specimen


def test_files_name_their_needles_and_a_table_may_leave_out_a_word_of_the_names(tmp_path):
    for n, curve in enumerate(NEEDLES):
        rows = [["x [mm]", "y [mm]", "z [mm]"], *curve.tolist()]
        write_sheets(tmp_path / f"needle_A{n}.xlsx", Sheet1=rows, Sheet2=[])
    assert [*curves_of([tmp_path])[0]] == ["needle_A0", "needle_A1", "needle_A2"]
    for names in ("A0 A1 A2", "needle_A0 A1 A2"):
        rows = [
            ("needle", "bevel side (clock)"),
            *zip(names.split(), ("12 o'clock", "6 o'clock", "6 o'clock"), strict=True),
        ]
        facts = write_rows(tmp_path / "facts.csv", rows)
        curves, _ = curves_of([tmp_path])
        assert [curve.stated["bevel_side"].to_angle() for curve in curves.values()] == [0, 180, 180]
    write_rows(facts, [("needle", "depth [mm]"), ("A0", 60), ("A1", 55), ("B2", 50)])
    assert "B2" in refusal(DataError, "B2", curves_of, [tmp_path]).what
    write_rows(facts, [("who", "colour"), ("A0", "red"), ("A1", "red")])
    refused = refusal(DataError, "facts.csv", curves_of, [*sorted(tmp_path.iterdir())])
    assert """--set 'unused=["facts.csv"]'""" in refused.fix and len(curves_of([tmp_path])[0]) == 3


def test_each_of_several_media_has_a_study_of_its_own(tmp_path):
    cells = [("soft gel", 20), ("soft gel", 20), ("hard", "none")]
    file = write_long(tmp_path, NEEDLES, head=("medium", "boundaries [mm]"), cells=cells)
    folder = write_placed(tmp_path / "a", [file], pose="1,0,0", bevel="0,1,0", point_sd="0.1")
    studies = {path.name: read_toml(path) for path in folder.glob("a_*.toml")}
    chosen = {name: (study["tune"]["medium"], study["medium"]) for name, study in studies.items()}
    soft, hard = ("soft gel", "./tissue_soft_gel.toml"), ("hard", "./tissue_hard.toml")
    assert chosen == {"a_soft_gel_study.toml": soft, "a_hard_fit.toml": hard}
    layers = [read_toml(folder / f"tissue_{name}.toml")["layers"] for name in ("soft_gel", "hard")]
    assert layers == [2, 1] and (folder / "scene_hard.toml").is_file()


@pytest.mark.parametrize(
    ("blocks", "unit"), [(["A", "A", "B"], "specimen"), (["A", "A", "A"], "insertion"), (["A"], None)]
)
def test_tracks_of_several_specimens_have_a_study_that_leaves_one_out(tmp_path, blocks, unit):
    depths = range(0, 61, 5)
    rows = [(f"r{n}", block, x, 4e-4 * x * x) for n, block in enumerate(blocks) for x in depths]
    file = write_rows(tmp_path / "a.csv", [("run", "block", "depth [mm]", "deflection [mm]"), *rows])
    folder = write_placed(tmp_path / "a", [file], point_sd="0.1")
    (path,) = folder.glob("a_*.toml")
    study = read_toml(path)
    assert study.get("leave_out") == unit and study.get("same_specimen", False) == (unit != "specimen")
    dataset = read(folder)
    assert [one.specimen for one in dataset.insertions] == blocks


def test_folders_and_parts_of_names_of_files_may_be_specimens(tmp_path):
    """Of three folders with files of the same names, and of files of one folder."""
    head, blocks = ["x [mm]", "y [mm]", "z [mm]"], ["A", "A", "B"]
    for n, (block, curve) in enumerate(zip(blocks, NEEDLES, strict=True)):
        (tmp_path / f"blocks/{block}").mkdir(parents=True, exist_ok=True)
        write_rows(tmp_path / f"blocks/{block}/{n}.csv", [head, *curve])
        write_rows(tmp_path / f"insertion_{n}_block{block}.csv", [head, *curve])
    files = sorted(tmp_path.glob("*.csv"))
    by_file = {"specimen__source": "file", "specimen__pattern": r".*?(block[-_ ]?[^\W_]+).*"}
    for paths, stated, names in (
        ([tmp_path / "blocks"], {"specimen__source": "folder"}, blocks),
        (files, by_file, [f"block{name}" for name in blocks]),
    ):
        fix = refusal(DataError, "specimen of its own", planned, paths).fix
        assert all(f"{key.replace('__', '.')}={value}" in fix for key, value in stated.items())
        assert [row.specimen for row in planned(paths, **stated)[0].rows] == names
    folder = write_placed(tmp_path / "out", [tmp_path / "blocks"], specimen__source="folder")
    again = prepare_import([tmp_path / "blocks"], mapping=folder / "mapping.toml")
    assert [row.specimen for row in again.plan.rows] == blocks


def test_angles_along_a_needle_are_integrated():
    """A circle of radius 100 mm, by its angles at lengths."""
    arcs = np.linspace(0.0, 50.0, 26)
    x, y, z = integrate_angles(arcs, np.degrees(arcs / 100)).T
    assert_allclose(x, 100 * np.sin(arcs / 100), atol=2e-3)
    assert_allclose(y, 100 * (1 - np.cos(arcs / 100)), atol=2e-3)
    assert not z.any()


# ---- a mapping that was written


def test_a_mapping_reads_further_files_without_a_question(tmp_path):
    first = write_rows(tmp_path / "scan1.csv", long_rows(["Serie", "a", "b", "c"]))
    stated = {
        "needle__column": "Serie",
        "x__column": "a",
        "y__column": "b",
        "z__column": "c",
        "pose": "1,0,0",
    }
    prepared = prepare([first], **stated)
    folder = write_placed(tmp_path / "gel", [first], **stated)
    text = (folder / "mapping.toml").read_text()
    (tmp_path / "lab.toml").write_text(text.replace('"scan1.csv"', '"scan*.csv"'))
    second = write_rows(tmp_path / "scan2.csv", long_rows(["Serie", "a", "b", "c"]))
    again = prepare_import([second], mapping=tmp_path / "lab.toml")
    assert len(again.content.curves) == 3 and again.mapping.values == prepared.mapping.values
    write_rows(second, long_rows(["Series", "a", "b", "c"]))
    error = refusal(DataError, "'Serie'", prepare_import, [second], mapping=tmp_path / "lab.toml")
    assert "columns.needle.column=Series" in error.fix and "Series, a, b, c" in error.expected
    fixed = prepare_import([second], [("tables.1.columns.needle.column", "Series")], tmp_path / "lab.toml")
    assert len(fixed.content.curves) == 3
    (tmp_path / "other.csv").write_text("x\n1\n")
    assert (
        "other.csv"
        in refusal(
            DataError, "", prepare_import, [tmp_path / "other.csv"], mapping=tmp_path / "lab.toml"
        ).expected
    )
    refusal(ConfigError, "", prepare_import, [second], [("y.column", "b")], tmp_path / "lab.toml")


# ---- the workbook and the command


def test_the_workbook_to_fill_in_is_read(tmp_path):
    file = tmp_path / "own.xlsx"
    assert run("new", "workbook", file) == 0
    assert run("new", "workbook", file) == 3
    prepared = prepare([file], point_sd="0.2")
    assert [one.name for one in prepared.content.curves] == [f"n{n}" for n in range(1, 9)]
    assert prepared.plan.point_sd_mm == 0.2 and not prepared.mapping.assumed
    assert prepared.mapping.origin == "example"
    assert {what for what, _ in prepared.unused} >= {"sheet points", "sheet needles"}


def test_examples_of_the_workbook_are_never_measured(tmp_path):
    examples = next(one for one in read_sheets(WORKBOOK_FILE) if one.sheet == "example points").rows
    own = [[f"own {n}", *point] for n in (1, 2) for point in needle(n).tolist()]
    file = write_rows(tmp_path / "mixed.csv", [*examples, *own])
    found = inspect(write_placed(tmp_path / "mixed", [file], origin="measured"))
    assert found.dataset.origin == "example"
    (warning,) = (one for one in found.warnings if one.kind == "examples")
    assert warning.kind in CONTRADICTIONS and "n1, n2, n3, n4, n5, n6, n7, n8" in warning.what
    file = write_rows(tmp_path / "own.csv", [examples[0], *own])
    unsure, sure = (prepare([file], origin=origin).mapping for origin in ("example", "measured"))
    assert (unsure.origin, sure.origin) == ("example", "measured")
    assert "origin" in unsure.assumed and "origin" not in sure.assumed


def test_a_unit_may_stand_in_the_name_of_a_value(tmp_path):
    points = [["x (mm)", "y (mm)", "z (mm)"], *NEEDLES[0].tolist()]
    setup = [["name", "value", "unit"], ["boundaries [cm]", "2; 4"], ["Needle_length (m)", 0.2, "m"]]
    plan = prepare([write_sheets(tmp_path / "a.xlsx", points=points, setup=setup)]).plan
    assert plan.boundaries_mm == {"medium1": (20.0, 40.0)} and plan.needle.length_mm == pytest.approx(200.0)


@pytest.mark.sweep
def test_a_workbook_that_unpacks_to_gigabytes_or_is_huge_is_refused(tmp_path):
    import zipfile

    from openpyxl import Workbook

    with zipfile.ZipFile(tmp_path / "bomb.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        for n in range(40):
            archive.writestr(f"xl/worksheets/sheet{n}.xml", b"\0" * 2**26)
    book = Workbook()
    book.active.cell(900_000, 3, 1.0)
    book.active.cell(1, 1, 1.0)
    book.save(tmp_path / "huge.xlsx")
    (tmp_path / "none.xlsx").write_bytes(b"PK\x03\x04 no archive")
    (tmp_path / "text.xls").write_text("x;y;z")
    for name in ("bomb.xlsx", "huge.xlsx", "none.xlsx", "text.xls"):
        refusal(DataError, name, read_sheets, tmp_path / name)


def test_the_command_writes_a_dataset_that_check_passes(tmp_path, capsys):
    write_european_csv(tmp_path / "six.csv", NEEDLES)
    words = ("import", tmp_path / "six.csv", "--set", "modulus=steel", "--yes")
    assert run(*words, "--out", tmp_path / "gel", "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert [one["insertion"] for one in shown["insertions"]] == ["Nadel_1", "Nadel_2", "Nadel_3"]
    found = inspect(tmp_path / "gel")
    assert not found.faults and {one.kind for one in found.warnings} >= {"placeholder", "assumed"}
    assert (tmp_path / "gel" / "import.png").stat().st_size > 10_000
    mapping = read_toml(tmp_path / "gel" / "mapping.toml")
    assert mapping["values"]["modulus"] == "steel" and "modulus" not in mapping["assumed"]
    assert list(read_toml(tmp_path / "gel" / "dataset.toml")["import"]["files"]) == ["six.csv"]
    assert (
        run(
            "import",
            tmp_path / "six.csv",
            "--mapping",
            tmp_path / "gel/mapping.toml",
            "--out",
            tmp_path / "again",
        )
        == 0
    )
    one, other = (sorted((tmp_path / name).rglob("*.[cp]*")) for name in ("gel", "again"))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]


@pytest.mark.parametrize("text", ["", "hello\n", "1,2,3\n", "x,y,z\n1,2,3\n4,a,6\n7,8,9\n1,2,3\n", "x,x,x\n"])
def test_bad_input_ends_in_exit_code_3_and_writes_nothing(tmp_path, text, capsys):
    (tmp_path / "a.csv").write_text(text)
    assert run("import", tmp_path / "a.csv", "--out", tmp_path / "gel", "--yes") == 3
    assert run("import", tmp_path / "none.xlsx", "--out", tmp_path / "gel", "--yes") == 3
    assert run("import", tmp_path, "--out", tmp_path / "gel", "--yes") == 3
    drafts = ["gel_mapping.toml"] if "4,a,6" in text else []  # whose cell may be corrected
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", *drafts]
    assert "a.csv" in capsys.readouterr().err
    (tmp_path / "dataset.toml").touch()
    for path in (tmp_path, tmp_path / "dataset.toml"):
        assert str(tmp_path / "dataset.toml") in refusal(DataError, "", prepare, [path]).fix


def test_a_draft_that_cannot_be_read_is_corrected_by_hand(tmp_path):
    points = ((20 * n, 0.1 * n**2) for n in range(5))
    file, draft = write_rows(tmp_path / "a.csv", ["xy", *points, ("lost", 2)]), tmp_path / "lab_mapping.toml"
    words = ("import", file, "--out", tmp_path / "lab", "--yes")
    assert run(*words, "--set", "unit=mm") == 3
    corrected = draft.read_text().replace("[[tables]]", '[[tables]]\nmissing = ["lost"]')
    draft.write_text(corrected)
    assert run(*words, "--set", "unit=mm") == 3 and draft.read_text() == corrected
    assert run(*words, "--mapping", draft) == 0
    assert read(tmp_path / "lab").insertions[0].depth == pytest.approx(80.0, abs=0.1)
    mapping = read_toml(tmp_path / "lab/mapping.toml")
    assert "is_draft" not in mapping and "diameter" in mapping["assumed"]


def test_files_of_one_name_are_told_apart_by_their_folders(tmp_path):
    files = [tmp_path / specimen / "45mm" / "needle.csv" for specimen in ("block 1", "block 2", "block 3")]
    for n, file in enumerate(files):
        file.parent.mkdir(parents=True)
        write_rows(file, [["x", "y", "z"], *NEEDLES[n].tolist()])
    names = [f"block_{n}_45mm_needle" for n in (1, 2, 3)]
    assert_read([*files, files[0].parent], names=names)
    assert_read([tmp_path], names=names)
    content = prepare(files).content
    assert [*content.files] == [f"block {n}/45mm/needle.csv" for n in (1, 2, 3)]
    (tmp_path / "block 1" / "50mm").mkdir()
    write_rows(tmp_path / "block 1" / "50mm" / "needle.csv", [["x", "y", "z"], *NEEDLES[0].tolist()])
    assert "specimen.pattern=(.+?)/.*" in refusal(DataError, "", prepare, [tmp_path]).fix
    of_blocks = prepare([tmp_path], specimen__source="file", specimen__pattern="(.+?)/.*")
    texts = [curve.stated["specimen"].text for curve in of_blocks.content.curves]
    assert texts == ["block 1", "block 1", "block 2", "block 3"]
    (tmp_path / "vtk").mkdir()
    (tmp_path / "vtk" / "needle.vtk").write_text("# vtk")
    assert "ParaView" in refusal(DataError, "", prepare, [tmp_path / "vtk"]).fix
