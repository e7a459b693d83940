"""Warnings about a finished fit: parameters at bounds, empirical curves that are closer, shared specimens."""

import ast
import math
import re
from pathlib import Path

import inference_cases
import numpy as np
import pandas as pd
import pytest
from inference_cases import TRUTH, two_layers
from pytest import approx
from reporting_results import study, with_frames
from test_datasets import CURVE, record, row

import needlefit
from needlefit.datasets.folds import make_folds, warn_shared_specimens
from needlefit.datasets.read import read
from needlefit.datasets.write import write_dataset
from needlefit.errors import ConfigError
from needlefit.inference.doubts import examine_depths
from needlefit.inference.draws import Draws
from needlefit.project.help_pages import TROUBLESHOOTING_PAGE, read_sections
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.study import StudyRecord
from needlefit.studies.fit_warnings import list_warnings
from needlefit.studies.identification import (
    ParameterInterval,
    ParameterRow,
    add_intervals,
    intervals_of_draws,
)


def warn(key, results):
    """Return the warnings about a run whose kinds begin with these letters."""
    return [one for one in list_warnings(results) if one.kind.startswith(key)]


BOUNDS = {"mu1_pa": (1e3, 1e9), "bevel_mm": (1e-3, 0.5)}


def fitted(values, folds_=1):
    """Return results whose fit ended at `values` in the last of so many folds, else in the middle."""
    results = study(1)
    first = results.frames["parameters"].query("method == 'fitted'").iloc[0].to_dict()
    rows = []
    for fold in range(folds_):
        for name, (low, high) in BOUNDS.items():
            value = values.get(name) if fold == folds_ - 1 else None
            place = {"parameter": name, "bound_low": low, "bound_high": high, "fold": f"fold {fold}"}
            value = value or np.sqrt(low * high)
            place |= {"value": value, "interval_low": value, "interval_high": value}
            rows.append({**first, **place, "status": "free"})
    return with_frames(results, parameters=pd.DataFrame(rows, columns=results.frames["parameters"].columns))


@pytest.mark.parametrize(
    ("values", "names"),
    [
        ({}, []),
        ({"mu1_pa": 1e9}, ["μ₁"]),
        ({"mu1_pa": 1.001e3, "bevel_mm": 0.4999}, ["μ₁", "b"]),
    ],
)
def test_a_parameter_at_its_bound_is_named(values, names):
    found = list(warn("parameter_at_bound", fitted(values)))
    assert [one.kind for one in found] == ["parameter_at_bound"] * len(names)
    assert all(f"fitted {name} lies" in one.what for name, one in zip(names, found, strict=True))


def scored(role, errors, floor=0.01):
    """Return results whose methods have these mean in-plane and tip errors, mm, insertion by insertion."""
    results = study(1)
    first = results.frames["errors"].iloc[0].to_dict() | {"role": role, "boundaries": "measured"}
    rows = [
        {**first, "method": method, "insertion": f"i{n}", "specimen": f"s{n}", "ipe_mean_mm": error}
        | {"te_mm": error, "floor_ipe_mean_mm": floor, "floor_te_mm": floor, "layers": 3, "medium": "gel"}
        for method, each in errors.items()
        for n, error in enumerate(each)
    ]
    frames = {"errors": rows, "shapes": []}
    return with_frames(
        results,
        **{name: pd.DataFrame(some, columns=results.frames[name].columns) for name, some in frames.items()},
    )


@pytest.mark.parametrize(
    ("errors", "floor", "kinds"),
    [
        ([0.05] * 5, 0.25, ["noise_too_large"]),
        ([0.05] * 2, 0.25, []),  # by chance
        ([0.25] * 5, 0.05, ["noise_too_small"]),
        ([0.25] * 5, np.nan, []),
    ],
)
def test_in_sample_errors_far_from_the_noise_floor_are_named(errors, floor, kinds):
    results = scored("tune", {"fitted": errors}, floor)
    found = list(warn("noise", results))
    assert [one.kind for one in found] == kinds
    assert all(f"n = {len(errors)}" in one.what for one in found)
    held_out = results.frames["errors"].assign(role="validate")
    assert list(warn("noise", with_frames(results, errors=held_out))) == []


@pytest.mark.parametrize(("signs", "count"), [((1, 1), 1), ((1, -1), 0)])
def test_a_residual_that_all_insertions_share_is_named(signs, count):
    results = study(1)
    shapes = results.frames["shapes"]
    turn = shapes["insertion"].map(
        {name: signs[n % 2] for n, name in enumerate(dict.fromkeys(shapes["insertion"]))}
    )
    bend = 0.02 * (shapes["simulated_x_mm"] - 60) ** 2 / 60
    shapes = shapes.assign(measured_y_mm=shapes["simulated_y_mm"] + turn * bend)
    assert len(warn("shared_residual", with_frames(results, shapes=shapes))) == count


def test_a_boundary_that_the_data_put_elsewhere_and_parameters_of_no_tissue_or_bevel_are_named():
    results = study(1)
    row = {"cause": "boundary", "where": "1", "size": -5.0, "sd": 1.0, "stated": 20.0}
    (shifted,) = warn("boundary_shift", results.with_metadata(common_doubt=row))
    assert all(part in shifted.what for part in ("15", "20"))
    assert warn("needle_outlier", results.with_metadata(common_doubt=row)) == []
    odd = {"insertion": "n5", "place": "insertions.csv:6", "sds": 6.3, "cause": "scaled", "size": 0.5}
    (named,) = warn("needle_outlier", results.with_metadata(odd_needles=[odd]))
    assert named.where == "insertions.csv:6"
    assert warn("units", results) == []
    parameters = results.frames["parameters"]
    is_mu = (parameters["parameter"] == "mu1_pa") & (parameters["method"] == "fitted")
    stiff = parameters.assign(value=parameters["value"].mask(is_mu, 1.6e8))
    assert len(warn("units", with_frames(results, parameters=stiff))) == 1
    is_bevel = (parameters["parameter"] == "bevel_mm") & (parameters["method"] == "fitted")
    flat = parameters.assign(value=parameters["value"].mask(is_bevel, math.tan(math.radians(0.3))))
    (one,) = warn("units", with_frames(results, parameters=flat))
    assert all(part in one.what for part in ("0.3", "1.7", "60"))


def test_a_modulus_leans_on_the_stated_depth_of_a_boundary():
    truth = {"mu1_pa": 2e5, "alpha1": 1.0, "mu2_pa": 3e4, "alpha2": 1.0, "bevel_mm": 0.12}
    tissue = inference_cases.medium(alpha2={"fixed": 1.0})
    made = [
        inference_cases.measure(truth, tissue, inference_cases.insertion(depth, (20.0,), (1, 2), side))
        for depth, side in ((50.0, 1), (60.0, -1), (70.0, 1))
    ]
    problem = inference_cases.problem(tissue, made)
    (row,) = examine_depths(problem, problem.parameters.theta(truth))
    assert row.sd_mm > 0 and row.factor_per_mm > 1 and row.parameter in problem.names


def test_specimens_on_both_sides_are_named_unless_the_study_leaves_specimens_out(tmp_path):
    rows = [
        row(name, "gel", layers=1, specimen=piece) for name, piece in (("a", "x"), ("b", "x"), ("c", "y"))
    ]
    tables = record(media={"gel": {}}, noise={"point_sd_mm": 0.02})
    beside = np.array([0, 0, 1e-3])
    curves = {"a": CURVE, "b": CURVE + beside, "c": CURVE + 2 * beside, "d": CURVE}
    rows.append(row("d", "gel", layers=1, specimen="z"))
    dataset = read(write_dataset(tmp_path, tables, rows, curves, {}))

    def shared(**keys):
        table = {"schema": 1, "dataset": "d", "medium": "m", **keys}
        return [
            one.what
            for one in warn_shared_specimens("mine", make_folds(StudyRecord.model_validate(table), dataset))
        ]

    first = {"tune": {"insertions": ["a"]}}
    (warning,) = shared(**first, validate=[{"insertions": ["b", "c"]}])
    assert "(x)" in warning
    assert shared(**first, validate=[{"insertions": ["c"]}]) == []
    kept = {"tune": {"insertions": ["a", "b", "c"]}}
    assert shared(**kept, leave_out="specimen") == []
    assert len(shared(**kept, leave_out="insertion")) == 1
    for copied in ({**first, "validate": [{"insertions": ["c", "d"]}]}, {"leave_out": "insertion"}):
        with pytest.raises(ConfigError) as caught:
            shared(**copied)
        assert all(name in str(caught.value) for name in ("a", "d")) and caught.value.key == "validate"


def _kinds_in_sources():
    """Return the kinds of all warnings that the package makes."""
    package = Path(needlefit.__file__).parent
    calls = [
        call
        for path in package.rglob("*.py")
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "ResultWarning"
    ]
    stated = [[*call.args[:1], *(one.value for one in call.keywords if one.arg == "kind")] for call in calls]
    named = {kind.value for every in stated for kind in every if isinstance(kind, ast.Constant)}
    assert len(named) > 18
    return named


def test_every_kind_of_warning_has_a_section_that_explains_it():
    sections = read_sections()
    page = (Path(__file__).parents[1] / TROUBLESHOOTING_PAGE).read_text(encoding="utf-8")
    assert set(sections) == set(re.findall(r"^\((.+)\)=$", page, re.MULTILINE))
    assert {ResultWarning(kind, "").help_key for kind in _kinds_in_sources()} <= set(sections)
    for one in sections.values():
        assert (
            one.title
            and one.paragraphs
            and not re.search(r"\]\(|\*\*|^#", "\n".join(one.paragraphs), re.MULTILINE)
        )


PROFILE = {"parameter": "mu1_pa", "low": 2e5, "high": 3e5, "determined": "yes"}


def parameter_row(**changed):
    row = ParameterRow("all", "fitted", "mu1_pa", 2.5e5, "free", 1e3, 1e9, determined="yes")
    return row._replace(**changed)


def test_certified_draws_give_the_interval_and_others_none():
    parameters = two_layers().parameters
    theta = np.array(parameters.theta(TRUTH))
    thetas = theta + np.linspace(-0.1, 0.1, 201)[:, None]
    drawn = Draws(thetas, "importance")
    found = intervals_of_draws(parameters, drawn, None)["mu1_pa"]
    assert (found.low, found.high) == approx((3e5 * math.exp(-0.095), 3e5 * math.exp(0.095)))
    assert found.source == "importance"
    faulty = Draws(thetas, "importance", ("k",))
    assert intervals_of_draws(parameters, faulty, None) == {}


def test_a_wide_interval_of_draws_takes_back_the_verdict_of_information_and_profile():
    sampled = {"mu1_pa": ParameterInterval(1e4, 1e7, "posterior")}
    (row,), (judged,) = add_intervals([parameter_row()], [PROFILE], sampled, {}, {"mu1_pa": True}, {})
    assert row.determined == judged["determined"] == "only together"
    for one in (row._asdict(), judged):
        assert (one["interval_low"], one["interval_high"]) == approx((1e4, 1e7))
        assert one["draw_source"] == "posterior"


def test_an_interval_allows_for_a_model_error_about_its_median_and_within_the_bounds():
    sd = 0.3
    low, high = (2e5 * math.exp(side * 1.96 * sd) for side in (-1, 1))
    row = parameter_row(bound_high=4e5)
    found = {"mu1_pa": ParameterInterval(low, high, "posterior", 2e5)}
    (row,), _ = add_intervals([row], [], found, {}, {}, {"mu1_pa": 0.4})  # 0.3 and 0.4 together: 0.5
    assert row.interval == (approx(2e5 * math.exp(-1.96 * 0.5)), 4e5)
    assert row.determined == "no"
