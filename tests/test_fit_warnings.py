"""Warnings about a finished fit: parameters at bounds, empirical curves that are closer, shared specimens."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from reporting_results import study
from test_cli import run
from test_datasets import CURVE, record, row

from needlefit.datasets.read import read
from needlefit.datasets.write import write_dataset
from needlefit.inference.parameters import Parameters
from needlefit.project.result_warnings import read_warnings, warnings_entry
from needlefit.project.toml import load
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.fit_warnings import (
    RULES,
    analysis_bound_warnings,
    apply_rule,
    cut_off_warnings,
)
from needlefit.studies.folds import make_folds, warn_shared_specimens
from needlefit.studies.job import DATA_WARNINGS, Settings, prepare
from needlefit.studies.kinds.cross_validation.run import run as run_fit
from needlefit.studies.report import warning_blocks
from needlefit.studies.run import Run


def warn(key: str, results: Run):
    """Return the warnings about a run whose texts' keys begin with these letters."""
    return [
        one for rule in RULES if (rule.text or rule.kind).startswith(key) for one in apply_rule(rule, results)
    ]


BOUNDS = {"mu1_pa": (1e3, 1e9), "bevel_mm": (1e-3, 0.5)}


def fitted(values: dict[str, float], folds_: int = 1) -> Run:
    """Return results whose fit ended at `values` in the last of so many folds, else in the middle."""
    results = study(1)
    first = results.frames["parameters"].query("method == 'fitted'").iloc[0].to_dict()
    rows = []
    for fold in range(folds_):
        for name, (low, high) in BOUNDS.items():
            value = values.get(name) if fold == folds_ - 1 else None
            place = {"parameter": name, "bound_low": low, "bound_high": high, "fold": f"fold {fold}"}
            rows.append({**first, **place, "status": "free", "value": value or np.sqrt(low * high)})
    return results.with_frames(parameters=pd.DataFrame(rows, columns=results.frames["parameters"].columns))


@pytest.mark.parametrize(
    ("values", "names"),
    [
        ({}, []),
        ({"mu1_pa": 1e9}, ["mu1"]),
        ({"mu1_pa": 1.001e3, "bevel_mm": 0.4999}, ["mu1", "b"]),
        ({"mu1_pa": 2e3, "bevel_mm": 0.45}, []),
    ],
)
def test_a_parameter_at_its_bound_is_named(values, names):
    found = list(warn("parameter_at_bound", fitted(values)))
    assert [one.kind for one in found] == ["parameter_at_bound"] * len(names)
    assert all(f"fitted {name} lies" in one.what for name, one in zip(names, found, strict=True))


def test_of_several_folds_one_warning_counts_them():
    (one,) = warn("parameter_at_bound", fitted({"mu1_pa": 1e9}, 3))
    assert "1 of 3 folds" in one.what


def scored(role: str, errors: dict[str, list[float]], floor: float = 0.01) -> Run:
    """Return results whose methods have these mean in-plane and tip errors, mm, insertion by insertion."""
    results = study(1)
    first = results.frames["errors"].iloc[0].to_dict() | {"role": role, "boundaries": "measured"}
    rows = [
        {**first, "method": method, "insertion": f"i{n}", "specimen": f"s{n}", "ipe_mean_mm": error}
        | {"te_mm": error, "floor_ipe_mean_mm": floor, "floor_te_mm": floor, "layers": 3, "medium": "gel"}
        for method, each in errors.items()
        for n, error in enumerate(each)
    ]
    return results.with_frames(errors=pd.DataFrame(rows, columns=results.frames["errors"].columns))


def test_an_analysis_names_the_parameters_that_its_fits_left_at_a_bound():
    parameters = {name: Parameters(tuple(BOUNDS), BOUNDS, {}, {}) for name in ("one", "other")}
    rows = [("one", "mu1_pa", 1e9), ("one", "mu1_pa", 1e6), ("one", "sd", 1e9), ("other", "bevel_mm", 0.1)]
    fits = pd.DataFrame(rows, columns=["candidate", "parameter", "value"])
    (found,) = analysis_bound_warnings(fits, parameters)
    assert (
        found.kind == "parameter_at_bound"
        and re.search(r"mu1\b.*\bone\b", found.what)
        and "1 of 2" in found.what
    )


def test_an_interval_that_ends_at_a_bound_is_named_unless_the_value_lies_there():
    parameters = {"gel": Parameters(tuple(BOUNDS), BOUNDS, {}, {})}
    high = BOUNDS["mu1_pa"][1]
    rows = [(1e6, 1e5, 1e7), (1e6, 1e5, 0.99 * high), (high, 1e5, high)]
    fits = pd.DataFrame([("gel", "mu1_pa", *row) for row in rows])
    fits.columns = ["fit", "parameter", "value", "p2_5", "p97_5"]
    (found,) = cut_off_warnings(fits, parameters)
    assert found.kind == "parameter_at_bound" and "upper" in found.what and "1 of 3" in found.what


FAR, NEAR = [0.26, 0.24, 0.25, 0.26, 0.27], [0.04, 0.05, 0.04, 0.03, 0.04]
LIKE = [0.26, 0.20, 0.28, 0.22, 0.25]


@pytest.mark.parametrize(
    ("role", "curve", "floor", "count"),
    [
        ("validate", NEAR, 0.5, 1),
        ("validate", LIKE, 0.0, 0),
        ("tune", NEAR, 0.05, 1),
        ("tune", NEAR, 0.5, 1),
        ("tune", LIKE, 0.0, 0),
        ("tune", NEAR, np.nan, 1),
        ("tune", FAR, 0.01, 0),
        ("tune", NEAR[:1], 0.05, 1),
        ("validate", [0.2599], 0.0, 0),  # one insertion: no standard error
        ("validate", [0.14], 0.0, 0),
        ("validate", [0.12], 0.0, 1),
        ("validate", [0.27], 0.0, 0),
    ],
)
def test_an_empirical_curve_that_is_closer_is_named(role, curve, floor, count):
    errors = {"fitted": FAR[: len(curve)], "straight": LIKE[: len(curve)], "constant_curvature": curve}
    found = list(warn("worse_than_baseline", scored(role, errors, floor)))
    assert [one.kind for one in found] == ["worse_than_baseline"] * count
    assert all("constant curvature" in one.what for one in found)
    below = floor > FAR[0]
    assert all(("noise floor" in one.fix) is below for one in found)


@pytest.mark.parametrize(
    ("errors", "floor", "kinds"),
    [
        ([0.05] * 5, 0.25, ["noise_too_large"]),
        ([0.05] * 2, 0.25, []),  # by chance
        ([0.05] * 5, 0.06, []),
        ([0.25] * 5, 0.05, ["noise_too_small"]),
        ([0.12], 0.05, []),
        ([0.25] * 5, np.nan, []),
    ],
)
def test_in_sample_errors_far_from_the_noise_floor_are_named(errors, floor, kinds):
    results = scored("tune", {"fitted": errors}, floor)
    found = list(warn("noise", results))
    assert [one.kind for one in found] == kinds
    assert all(f"n = {len(errors)}" in one.what for one in found)
    held_out = results.frames["errors"].assign(role="validate")
    assert list(warn("noise", results.with_frames(errors=held_out))) == []


def test_the_closest_curve_is_named_and_the_report_shows_it():
    errors = {"fitted": FAR, "straight": [0.1] * 5, "constant_curvature": NEAR}
    results = scored("validate", errors)
    (one,) = warn("worse_than_baseline", results)
    assert "constant curvature" in one.what and "0.040 mm against 0.256 mm" in one.what
    blocks = warning_blocks(replace(results, run={**results.run, **warnings_entry([one])}))
    assert sum(one.what in str(block) for block in blocks) == 1
    assert read_warnings(warnings_entry([one])) == (one,)


def test_specimens_on_both_sides_are_named_unless_the_study_leaves_specimens_out(tmp_path):
    rows = [
        row(name, "gel", layers=1, specimen=piece) for name, piece in (("a", "x"), ("b", "x"), ("c", "y"))
    ]
    tables = record(media={"gel": {}}, noise={"point_sd_mm": 0.02})
    beside = np.array([0, 0, 1e-3])
    curves = {"a": CURVE, "b": CURVE + beside, "c": CURVE + 2 * beside, "d": CURVE}
    rows.append(row("d", "gel", layers=1, specimen="z"))
    dataset = read(write_dataset(tmp_path, tables, rows, curves, {}))

    def shared(**keys: object) -> list[str]:
        table = {"schema": 1, "dataset": "d", "medium": "m", **keys}
        return [
            one.what
            for one in warn_shared_specimens("mine", make_folds(StudyRecord.model_validate(table), dataset))
        ]

    first = {"tune": {"insertions": ["a"]}}
    (warning,) = shared(**first, validate=[{"insertions": ["b", "c"]}])
    assert "(x)" in warning
    assert shared(**first, validate=[{"insertions": ["c"]}]) == []
    (copied,) = shared(**first, validate=[{"insertions": ["c", "d"]}])
    assert "d, " in copied and "(x)" not in copied
    assert shared(tune={"insertions": ["a", "b", "c"]}, leave_out="specimen") == []
    assert len(shared(leave_out="insertion")) == 1


GEL = """
schema = 1
layers = 1
[parameters]
mu1_pa = { bounds = [1e3, 1e9] }
alpha1 = { fixed = 1.0 }
bevel_mm = { bounds = [1e-3, 0.5] }
"""

FAST = """
schema = 1
starts = 2
metric = false
[likelihood]
bevel_spread = 0.0
"""
FLIPPED = """
schema = 1
dataset = "./data"
medium = "./gel.toml"
recipe = "./fast.toml"
[tune]
insertions = ["a", "b"]
"""


@pytest.fixture
def flipped(tmp_path, monkeypatch):
    """A fit to needles whose bevels are stated to face the other side."""
    monkeypatch.chdir(tmp_path)
    rows = [row(name, "gel", layers=1, bevel=np.array([0, 1.0, 0]), side=-1) for name in "ab"]
    tables = record(media={"gel": {}}, noise={"point_sd_mm": 0.02})
    write_dataset(tmp_path / "data", tables, rows, dict.fromkeys("ab", CURVE), {})
    (tmp_path / "gel.toml").write_text(GEL)
    (tmp_path / "fast.toml").write_text(FAST)
    (tmp_path / "fit.toml").write_text(FLIPPED)
    return tmp_path


CAUSE_AND_EFFECT = {"bevel_side", "parameter_at_bound", "worse_than_baseline"}


@pytest.mark.sweep
def test_a_fit_to_flipped_bevels_warns_of_cause_and_effect(flipped):
    results = run_fit("fit", load(flipped / "fit.toml", FitRecord), Settings())
    assert {one["kind"] for one in results.run["warnings"]} >= CAUSE_AND_EFFECT
    assert "insertions.csv:2" in {one["where"] for one in results.run["warnings"]}


@pytest.mark.sweep
def test_tune_prints_its_warnings_and_writes_the_result_all_the_same(flipped, capsys):
    assert run("tune", "./fit.toml", "-q", "--strict") == 5
    err = capsys.readouterr().err
    warnings = json.loads((flipped / "reports/fit/run.json").read_text())["warnings"]
    assert {one["kind"] for one in warnings} >= CAUSE_AND_EFFECT
    # That of the data is printed before the fit begins, and again with all others at its end.
    assert [one["kind"] for one in warnings if one["kind"] in DATA_WARNINGS] == ["bevel_side"]
    assert err.count("needlefit: warning: ") == 1 + len(warnings)
    assert err.count(" (needlefit explain ") == len(warnings)
    assert err.count("data/insertions.csv:2") == 2


HELD_OUT = """
schema = 2
dataset = "./data"
medium = "./gel.toml"
recipe = "./fast.toml"
validate = [{ insertions = ["c", "d", "e"] }]
[tune]
insertions = ["a", "b"]
"""


@pytest.mark.sweep
def test_every_warning_that_a_study_prints_is_in_run_json(flipped, capsys):
    rows = [row(name, "gel", layers=1, bevel=np.array([0, 1.0, 0])) for name in "abcde"]
    bent = CURVE * [1, 3, 1]
    curves = dict.fromkeys("ab", CURVE) | dict.fromkeys("cde", bent)
    tables = record(media={"gel": {}}, noise={"point_sd_mm": 0.02})
    write_dataset(flipped / "other", tables, rows, curves, {})
    (flipped / "study.toml").write_text(HELD_OUT.replace("./data", "./other"))
    assert run("validate", "./study.toml", "-q") == 0
    printed = re.findall(r"needlefit explain ([\w-]+)", capsys.readouterr().err)
    warnings = json.loads((flipped / "reports/study/run.json").read_text())["warnings"]
    assert sorted(printed) == sorted(one["kind"].replace("_", "-") for one in warnings)
    assert "wide_intervals" in {one["kind"] for one in warnings}


@pytest.mark.parametrize(
    ("file", "old", "new", "place"),
    [
        ("fit.toml", '"a", "b"', '"a", "d"', "fit.toml:7"),
        ("fit.toml", '"./data"', '"dato"', "fit.toml:3"),
        ("fit.toml", '"./gel.toml"', '"gol"', "fit.toml:4"),
        ("gel.toml", "alpha1", "alpha2", "gel.toml:6"),
        ("gel.toml", "mu1_pa", "mu2_pa", "gel.toml:5"),
        ("gel.toml", "{ fixed = 1.0 }", '{ tie = "mu1_pa" }', "gel.toml:6"),
        ("gel.toml", "{ fixed = 1.0 }", '{ tie = "mu1" }', "gel.toml:6"),
        ("gel.toml", "[1e3, 1e9]", "[-1, 1e9]", "gel.toml:5"),
    ],
)
def test_an_error_of_a_study_or_medium_names_file_and_line(flipped, capsys, file, old, new, place):
    path = flipped / file
    path.write_text(path.read_text().replace(old, new))
    for command in ("tune", "identify"):
        assert run(command, "./fit.toml", "-q") == 3
        err = capsys.readouterr().err
        assert err.startswith(f"needlefit: {place}: ") and "\n  fix: " in err


COMPARED = """
schema = 1
kind = "comparison"
title = "t"
question = "q"
dataset = "./data"
medium = "./gel.toml"
folds = 2
insertions = { insertions = ["a", "b"] }
"""
ADAPTED = """
schema = 1
kind = "adaptation"
title = "t"
question = "q"
dataset = "./data"
recipe = "./fast.toml"
counts = [0]
[old]
medium = "./gel.toml"
insertions = { insertions = ["a"] }
[new]
medium = "./gel.toml"
insertions = { insertions = ["b"] }
held_out = ["b"]
[between_media]
ln_mu_sd = 0.66
ln_bevel_sd = 0.60
source = "s"
"""


@pytest.mark.parametrize(
    ("study", "old", "new", "line"),
    [
        (COMPARED, '"a", "b"', '"a", "x"', 9),
        (COMPARED, '{ insertions = ["a", "b"] }', '{ medium = "x" }', 9),
        (COMPARED, "./gel.toml", "gol", 7),
        (COMPARED, "folds = 2", "folds = 3", 8),
        (ADAPTED, '["a"]', '["x"]', 11),
        (ADAPTED, '["b"] }', '["x"] }', 14),
        (ADAPTED, 'held_out = ["b"]', 'held_out = ["a"]', 15),
        (ADAPTED, 'held_out = ["b"]', 'held_out = ["x"]', 15),
    ],
)
def test_an_error_of_a_study_that_analyses_names_its_file_and_line(flipped, capsys, study, old, new, line):
    assert old in study
    (flipped / "mine.toml").write_text(study.replace(old, new))
    assert run("validate", "./mine.toml", "-q") == 3
    assert f"\nneedlefit: mine.toml:{line}: " in "\n" + capsys.readouterr().err


def test_the_warning_about_specimens_names_the_file_and_line_of_the_study(flipped):
    table = flipped / "data/insertions.csv"
    table.write_text(table.read_text().replace(",a,", ",x,").replace(",b,", ",x,"))
    data = flipped / "data/dataset.toml"
    data.write_text(data.read_text().split("[checksums]")[0])
    file = flipped / "mine.toml"
    file.write_text(FLIPPED.replace(', "b"', "") + '\n[[validate]]\ninsertions = ["b"]\n')
    found = prepare("mine", load(file, StudyRecord), Settings(file=file)).warnings
    assert [one.where for one in found if one.kind == "same_specimen"] == [f"{file}:9"]
