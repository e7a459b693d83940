"""Readers on anything: a table, or an error that names the place; never another exception."""

import math
import os

import numpy as np
import pytest
from compression_cases import specimen, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refusal
from test_datasets import block, without_checksums
from track_cases import DEPTH, GUIDE, TOML, measured, track, written

from needlefit.datasets.compression import read_compression
from needlefit.datasets.formats.csv import parse_numbers, read_table
from needlefit.datasets.read import check, read, read_shapes
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError, DataError
from needlefit.project.locate import shipped_folder
from needlefit.schemas.study import SelectionRecord

anything = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
finite = st.floats(-1e6, 1e6)


@given(st.lists(st.tuples(finite, finite, st.integers(0, 3)), min_size=1, max_size=20))
@anything
def test_numbers_and_lines_survive_whatever_blank_lines_stand_between(tmp_path, rows):
    path = tmp_path / "t.csv"
    text, lines = "a,b\n", []
    for a, b, blanks in rows:
        text += "\n" * blanks
        lines.append(text.count("\n") + 1)
        text += f"{a!r},{b!r}\n"
    path.write_text(text)
    table, found = read_table(path), []
    values = np.column_stack([parse_numbers(table, column, found) for column in "ab"])
    assert not found and table.lines.tolist() == lines
    np.testing.assert_allclose(values, [row[:2] for row in rows], rtol=1e-14)


SECRET = [
    "root:x:0:0:root:/root:/bin/bash\nuser:x:1:1:,,,:/home:/bin/sh\n",
    "hunter2\ncorrect horse\n",
    "-----BEGIN KEY-----\nMIIEvQIBADANBg,kqhkiG9w0B\n",
    '{"token": "hunter2,x:0"}\n{"token": "x:0"}\n',
]


@pytest.mark.parametrize("name", ["insertions.csv", "centerlines/b.csv"])
@pytest.mark.parametrize("content", SECRET)
def test_the_content_of_a_foreign_file_is_not_printed(tmp_path, name, content):
    folder = tmp_path / "block"
    without_checksums(block(folder))
    (tmp_path / "secret").write_text(content)
    (folder / name).unlink()
    (folder / name).symlink_to(tmp_path / "secret")
    found = check(folder)
    text = "".join(f"{fault.where} {fault.what} {fault.expected} {fault.fix}" for fault in found)
    assert found and not any(word in text for word in ("hunter2", "x:0", "MIIE", "BEGIN", "token"))


@pytest.mark.parametrize(
    "content",
    [
        ",".join(f"c{n}" for n in range(2000)) + "\n",
        "a" + "," * 900 + "\n" + "1\n" * 5000,
        'a,b\n1,"' + "x" * 200_000 + '"\n',
        "x" * 70 * 2**20,
    ],
    ids=["columns", "cells", "field", "size"],
)
def test_a_table_has_bounds(tmp_path, content):
    path = tmp_path / "t.csv"
    path.write_text(content)
    found = refusal(DataError, "", read_table, path)
    assert found.where.startswith(str(path)) and len(str(found)) < 1000


# ---- compression tests: every way to say stretch and stress, and every way to get them wrong

SPECIMEN = specimen(-3.0, 0.8)
KPA = (-1e3 * SPECIMEN.stress).tolist()
STRETCHES = SPECIMEN.stretch.tolist()


def write_columns(tmp_path, **columns):
    """A file gel.csv of these columns."""
    rows = list(zip(*columns.values(), strict=True))
    return write(tmp_path / "gel.csv", ",".join(columns), rows)


@pytest.mark.parametrize(("unit", "factor"), [("pa", 1e3), ("kpa", 1.0), ("mpa", 1e-3)])
@pytest.mark.parametrize("sign", [1, -1])
def test_units_and_either_sign_give_stresses_in_mpa_negative_in_compression(tmp_path, unit, factor, sign):
    path = write_columns(
        tmp_path, stretch=STRETCHES, **{f"true_stress_{unit}": [sign * factor * y for y in KPA]}
    )
    test = read_compression(path)
    assert test.measure == "true" and test.specimens[0].name == "gel"
    assert test.specimens[0].stress == pytest.approx(SPECIMEN.stress, rel=1e-12)
    assert ("positive" in " ".join(test.warnings)) == (sign > 0)


@pytest.mark.parametrize(("size", "value"), [("area_mm2", 50 * math.pi), ("diameter_mm", 10 * math.sqrt(2))])
def test_force_and_displacement_need_the_specimen_s_size_once(tmp_path, size, value):
    once = [""] * (len(STRETCHES) - 1)
    path = write_columns(
        tmp_path,
        sample=["a"] * len(STRETCHES),
        displacement_mm=[20 * (1 - x) for x in STRETCHES],
        height_mm=[20, *once],
        force_n=[y * 1e-3 * 50 * math.pi for y in KPA],
        **{size: [value, *once]},
    )
    test = read_compression(path)
    assert test.measure == "nominal" and test.specimens[0].name == "a"
    assert test.specimens[0].stretch == pytest.approx(SPECIMEN.stretch)
    assert test.specimens[0].stress == pytest.approx(SPECIMEN.stress, rel=1e-9)


def test_the_option_states_the_measure_of_stress(tmp_path):
    path = write_columns(tmp_path, stretch=STRETCHES, stress_kpa=KPA)
    assert read_compression(path, "true").measure == "true"
    error = refusal(DataError, "stress", read_compression, path)
    assert "--stress" in error.fix
    with pytest.raises(DataError, match=r"nominal.*--stress.*true"):
        read_compression(write_columns(tmp_path, stretch=STRETCHES, nominal_stress_kpa=KPA), "true")
    refusal(DataError, "no such file", read_compression, tmp_path / "none.csv")


def test_what_is_left_out_reversed_or_averaged_is_reported(tmp_path):
    back = [0.5 * y for y in KPA[::-1]]
    path = write_columns(tmp_path, stretch=[*STRETCHES, *STRETCHES[::-1]], nominal_stress_kpa=[*KPA, *back])
    test = read_compression(path)
    assert test.specimens[0].stretch == pytest.approx(SPECIMEN.stretch)
    assert "gel.csv:61" in test.warnings[1] and "50 %" in test.warnings[1]
    test = read_compression(write_columns(tmp_path, stretch=STRETCHES[::-1], nominal_stress_kpa=KPA[::-1]))
    assert test.specimens[0].stress == pytest.approx(SPECIMEN.stress)
    assert "smallest stretch up" in test.warnings[1]
    many = np.linspace(1, 0.8, 1000)
    path = write_columns(tmp_path, stretch=many, nominal_stress_kpa=10 * (1 - many))
    test = read_compression(path)
    one = test.specimens[0]
    assert len(one.stretch) == 200 and one.stretch[0] == pytest.approx(np.mean(many[:5]))
    assert one.stress == pytest.approx(-0.01 * (1 - one.stretch))
    assert "200 points" in test.warnings[1]
    shaken = np.array(STRETCHES) + 0.002 * np.random.default_rng(1).normal(size=60)
    test = read_compression(write_columns(tmp_path, stretch=np.minimum(shaken, 1), nominal_stress_kpa=KPA))
    assert len(test.specimens[0].stretch) == 60 and np.all(np.diff(test.specimens[0].stretch) <= 0)
    waits = 500
    path = write_columns(
        tmp_path,
        stretch=[STRETCHES[0]] * waits + list(STRETCHES),
        nominal_stress_kpa=[KPA[0]] * waits + list(KPA),
    )
    (one,) = read_compression(path).specimens
    assert one.stretch[-1] < one.stretch[0] == pytest.approx(STRETCHES[0])


def test_a_preload_gives_a_warning(tmp_path):
    assert not [
        warning for warning in read_compression(_loaded(tmp_path, 0.0)).warnings if "at stretch 1" in warning
    ]
    warnings = read_compression(_loaded(tmp_path, 0.1)).warnings
    assert " 9 % " in warnings[1] and "stretch 1" in warnings[1]  # 0.1 / 1.1


def _loaded(tmp_path, part):
    return write_columns(tmp_path, stretch=STRETCHES, nominal_stress_kpa=[y + part * KPA[-1] for y in KPA])


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"stretch": [100 * x for x in STRETCHES], "nominal_stress_kpa": KPA}, "percent"),
        ({"stretch": [1 - x for x in STRETCHES], "nominal_stress_kpa": KPA}, "strain"),
        ({"stretch": [x - 1 for x in STRETCHES], "nominal_stress_kpa": KPA}, "strain"),
        ({"stretch": [2 - x for x in STRETCHES], "nominal_stress_kpa": KPA}, "tension"),
        (
            {"stretch": [0.99 + 0.01 * x for x in [*[1.0] * 54, *STRETCHES[:6]]], "nominal_stress_kpa": KPA},
            "hardly",
        ),
        ({"stretch": [x + 0.1 for x in STRETCHES], "nominal_stress_kpa": KPA}, "tension and compression"),
        ({"stretch": STRETCHES, "nominal_stress_kpa": [y - KPA[30] for y in KPA]}, "through zero"),
        ({"stretch": STRETCHES, "nominal_stress_kpa": [0] * 60}, "0 throughout"),
        (
            {"stretch": STRETCHES, "nominal_stress_kpa": [*KPA[:-1], ""]},
            "gel.csv:61: nominal_stress_kpa ",
        ),
        ({"stretch": ["x", *STRETCHES[1:]], "nominal_stress_kpa": KPA}, "gel.csv:2: stretch is 'x'"),
        ({"stretch": STRETCHES[:5], "nominal_stress_kpa": KPA[:5]}, " 5 "),
        ({"stretch": STRETCHES, "stress": KPA}, "no columns give the stress"),
        ({"stretch": STRETCHES, "force_n": KPA}, "no columns give the stress"),
        ({"strain": STRETCHES, "nominal_stress_kpa": KPA}, "no columns give the stretch"),
        ({"stretch": STRETCHES, "nominal_stress_kpa": KPA, "true_stress_kpa": KPA}, "is given by"),
        ({"sample": [""] * 60, "stretch": STRETCHES, "nominal_stress_kpa": KPA}, "sample is empty"),
        (
            {"displacement_mm": KPA, "height_mm": [*[20] * 30, *[21] * 30], "nominal_stress_kpa": KPA},
            "height_mm of specimen gel is 20, 21",
        ),
        (
            {
                "stretch": [*STRETCHES, *STRETCHES[::-1], *STRETCHES],
                "nominal_stress_kpa": [*KPA, *KPA[::-1], *KPA],
            },
            " 2 times",
        ),
    ],
)
def test_faulty_tables_are_refused_with_a_fix(tmp_path, columns, expected):
    error = refusal(DataError, "", lambda: read_compression(write_columns(tmp_path, **columns)))
    assert expected in str(error)
    assert error.fix or "fix:" in str(error)


# ---- tip tracks: what is read, and the errors of faulty tables


@pytest.fixture(scope="module")
def runs():
    return [measured(track("rest", np.zeros(len(DEPTH)))), measured(track("moved", GUIDE))]


def table(folder):
    return folder / "steps.csv"


def edit(folder, line, **cells):
    """Change cells of one line of the table, counted as an editor does."""
    lines = table(folder).read_text().splitlines()
    names = lines[0].split(",")
    values = lines[line - 1].split(",")
    for name, value in cells.items():
        values[names.index(name)] = value
    lines[line - 1] = ",".join(values)
    table(folder).write_text("\n".join(lines) + "\n")


def test_runs_count_from_first_contact_and_an_invalid_reading_leaves_one_out(tmp_path, runs):
    dataset = read(written(tmp_path, runs))
    assert [one.id for one in dataset.insertions] == ["rest", "moved"]
    rest, moved = dataset.insertions
    assert moved.depths == pytest.approx(DEPTH) and moved.guide == pytest.approx(GUIDE)
    assert (rest.guided, moved.guided, moved.side, moved.sequence) == (False, True, 1, (1,))
    assert moved.tip == pytest.approx(runs[1].tip, abs=1e-5) and moved.heading is None
    assert check(tmp_path) == [] and dataset.noise.point_sd == 0.02
    folder = written(tmp_path, runs)
    edit(folder, 20, ok="0")
    dataset = read(folder)
    assert [one.id for one in dataset.insertions] == ["rest"]
    (remark,) = dataset.remarks
    assert all(part in remark for part in ("moved", "1 of its 13 readings", "26 mm"))


@pytest.mark.parametrize(
    ("line", "cells", "expected"),
    [
        (4, {"at_mm": "2.0"}, r"steps.csv:4: run rest .*5\.7 .* 2 mm"),
        (4, {"x_mm": "left"}, r"steps.csv:4: tip_mm|steps.csv:4: x_mm is 'left'"),
        (14, {"at_mm": "60700"}, r"steps.csv:14: .*60644\.3 mm"),
        (2, {"phantom": "wax"}, r"run rest .*'wax'"),
    ],
)
def test_faults_name_line_and_cell(tmp_path, runs, line, cells, expected):
    folder = written(tmp_path, runs)
    edit(folder, line, **cells)
    refusal(DataError, expected, read, folder)


def test_missing_columns_unknown_names_and_few_readings_are_refused(tmp_path, runs):
    folder = written(tmp_path / "a", runs, TOML.replace('"stage_mm"', '"stage"'))
    refusal(DataError, "`stage`", read, folder)
    folder = written(tmp_path / "b", runs, TOML.replace("guide_mm =", "template_mm ="))
    refusal(DataError, "template_mm", read, folder)
    folder = written(tmp_path / "c", runs)
    lines = table(folder).read_text().splitlines()
    table(folder).write_text("\n".join(lines[:5]) + "\n")
    refusal(DataError, r"run rest .*4 readings", read, folder)


def test_selections_and_layers_of_tracks(tmp_path, runs):
    folder = written(tmp_path, runs, TOML + "layers = [1, 2]\n")
    with pytest.raises(ConfigError, match=r"2 layers .*1 boundaries") as error:
        raise ConfigError(str(check(folder)[0]))
    assert "boundaries_mm" in str(error.value)
    refusal(DataError, "tip tracks", lambda: read_shapes(written(tmp_path, runs)))
    dataset = read(written(tmp_path, runs))
    assert [one.id for one in select_insertions(dataset, SelectionRecord(guided=True))] == ["moved"]
    with pytest.raises(ConfigError, match="insertion lost"):
        select_insertions(dataset, SelectionRecord(insertions=("lost",)))
    with pytest.raises(ConfigError, match="dataset mine"):
        select_insertions(dataset, SelectionRecord(insertions=("rest",), guided=True))


@pytest.mark.skipif("NEEDLEFIT_REAL_DATA" not in os.environ, reason="NEEDLEFIT_REAL_DATA is not set")
def test_the_public_tip_tracks():
    dataset = read(shipped_folder() / "data" / "guided_tips")
    assert len([one for one in dataset.insertions if not one.guided and one.medium == "phantomB"]) == 5
    assert any("phantomA_closedloop_03 " in remark for remark in dataset.remarks)
    for one in dataset.insertions:
        assert 90 < one.depths[-1] < 105 and np.abs(one.guide).max() < 13 and one.heading is not None
