"""`needlefit check` of studies and fits: their keys, and all that they name, without a simulation."""

import json

import pytest
from test_cli import run

from needlefit.project.toml import dumps, read_toml

STUDY = {
    "schema": 2,
    "dataset": "twin",
    "medium": "chicken",
    "leave_out": "specimen",
    "tune": {"medium": "chicken"},
}


def write(path, **changes):
    path.write_text(dumps({key: value for key, value in {**STUDY, **changes}.items() if value is not None}))
    return str(path)


@pytest.mark.parametrize(
    ("name", "kind", "folds"),
    [
        ("study3", "cross-validation", [{"tune": 1, "validate": 10}]),
        ("phantom1", "fit", [{"tune": 10, "validate": 0}]),
        ("adaptation3", "adaptation", []),
    ],
)
def test_a_shipped_study_has_no_faults(name, kind, folds, capsys):
    assert run("check", name, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ok"] and (found["kind"], found["folds"]) == (kind, folds)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"leave_out": "needle"}, "mine.toml:4"),
        ({"medium": "chiken"}, "mine.toml:3"),
        ({"recipe": "none"}, "mine.toml"),
        ({"tune": {"medium": "pork"}}, "mine.toml"),
        ({"tune": {"medium": "phantom1"}, "medium": "phantom1"}, 'leave_out = "insertion"'),
        ({"kind": "adaptation"}, "mine.toml"),
        ({"dataset": None, "medium": None, "leave_out": None}, "mine.toml"),
    ],
)
def test_a_fault_of_a_study_is_named_with_its_line(tmp_path, changes, named, capsys):
    assert run("check", write(tmp_path / "mine.toml", **changes)) == 3
    assert named in capsys.readouterr().err


def test_an_algorithm_that_the_likelihood_has_no_derivatives_for_is_a_fault(tmp_path, monkeypatch, capsys):
    from needlefit.project.locate import find_file

    recipe = tmp_path / "configs" / "recipes" / "default.toml"
    recipe.parent.mkdir(parents=True)
    table = read_toml(find_file("recipe", "default"))
    recipe.write_text(dumps({**table, "likelihood": {**table["likelihood"], "depths": "quadrature"}}))
    monkeypatch.chdir(tmp_path)
    assert run("check", "study3") == 3
    assert "leastsquares" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "kind"),
    [("comparison_twin", "comparison"), ("study2", "cross-validation"), ("sensitivity", "sensitivity")],
)
def test_a_study_is_one_by_its_path_too(name, kind, capsys):
    from needlefit.project.locate import find_file

    assert run("check", str(find_file("study", name).resolve()), "--json") == 0
    assert json.loads(capsys.readouterr().out)["kind"] == kind


def test_files_that_other_kinds_name_are_found(tmp_path, capsys):
    from needlefit.project.locate import find_file

    table = read_toml(find_file("study", "leave_one_out"))
    (tmp_path / "mine.toml").write_text(dumps({**table, "fits": ["phantom1", "phantom9"]}))
    assert run("check", str(tmp_path / "mine.toml")) == 3
    assert "phantom9" in capsys.readouterr().err


def test_a_file_that_is_neither_is_refused(tmp_path, capsys):
    (tmp_path / "tissue.toml").write_text("schema = 1\nlayers = 1\n")
    assert run("check", str(tmp_path / "tissue.toml")) == 3
    assert "tissue.toml" in capsys.readouterr().err
