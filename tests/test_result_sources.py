"""A result of one study is not replaced by that of another one, or of another dataset."""

import json
import shutil

import pytest
from test_cli import run
from world import copy_project

from needlefit.cli import execution
from needlefit.errors import ConfigError
from needlefit.studies.report import rebuild
from needlefit.studies.run import name_source, read_sources, require_same_sources


class StopError(Exception):
    """Raised where the work would begin."""


@pytest.fixture
def project(world, tmp_path, monkeypatch):
    """A copy of the project with the results of a fit, a study and a prediction."""
    folder = copy_project(world, tmp_path / "project", "fit", "cross_validation", "prediction")
    monkeypatch.chdir(folder)

    def stop(*_, **__):
        raise StopError

    monkeypatch.setattr(execution.Execution, "run", stop)
    return folder


def is_refused(line):
    """Return whether a command is refused before its work begins."""
    code = run(f"{line} --quiet --jobs 1")
    assert code in (1, 3)  # 1: of `StopError`
    return code == 3


def test_the_same_studies_may_replace_their_results_also_in_a_copy_of_the_project(project):
    for line in (
        "tune gel",
        "tune ./configs/fits/gel.toml",
        "tune reports/gel",
        "validate held_out",
        "predict held_out --scene ahead",
        "predict reports/held_out --scene ./configs/scenes/ahead.toml",
        "tune gel --design",  # no result yet
    ):
        assert not is_refused(line), line


def test_another_study_of_the_same_name_is_refused_and_both_are_named(project, capsys):
    for place in ("other", "other/scenes"):
        (project / place).mkdir()
    shutil.copy("studies/held_out.toml", "other/held_out.toml")
    shutil.copy("configs/fits/gel.toml", "other/gel.toml")
    shutil.copy("configs/scenes/ahead.toml", "other/scenes/ahead.toml")
    before = {path: path.read_bytes() for path in project.glob("reports/*/*.json")}
    for line, then, now in (
        ("validate", "studies/held_out.toml", "other/held_out.toml"),
        ("tune", "configs/fits/gel.toml", "other/gel.toml"),
        ("predict held_out --scene", "configs/scenes/ahead.toml", "other/scenes/ahead.toml"),
    ):
        capsys.readouterr()
        assert is_refused(f"{line} {now}")
        printed = capsys.readouterr().err
        assert str(project / then) in printed and str(project / now) in printed
        assert not is_refused(f"{line} {now} --out elsewhere")
    assert before == {path: path.read_bytes() for path in project.glob("reports/*/*.json")}


def test_another_dataset_of_the_same_study_is_refused(project, capsys):
    shutil.copytree("data/needles", "data/others")
    file = project / "data/others/dataset.toml"
    text = file.read_text()
    file.write_text(text.replace('name = "needles"', 'name = "others"'))
    assert file.read_text() != text
    study = project / "studies/held_out.toml"
    study.write_text(study.read_text().replace('dataset = "needles"', 'dataset = "others"'))
    assert is_refused("validate held_out")
    assert "dataset needles" in capsys.readouterr().err
    study.write_text(study.read_text().replace('dataset = "others"', 'dataset = "needles"'))
    (project / "data/needles/insertions.csv").touch()  # the data themselves may change
    assert not is_refused("validate held_out")


def test_a_result_made_again_elsewhere_keeps_its_sources_and_older_ones_have_none(project):
    rebuild(project / "reports/held_out", project / "again/deep/held_out")
    timing = json.loads((project / "again/deep/held_out/timing.json").read_text())
    assert timing["sources"] == ["../../../studies/held_out.toml"]
    own, other = name_source(project / "studies/held_out.toml"), name_source(project / "studies/meat.toml")
    assert read_sources(timing, project / "again/deep/held_out") == [own]
    for folder in (project / "reports/held_out", project / "again/deep/held_out"):
        require_same_sources(folder, [own])
        with pytest.raises(ConfigError):
            require_same_sources(folder, [other])
    (project / "reports/held_out/timing.json").write_text("{}")
    require_same_sources(project / "reports/held_out", [other])
    (project / "reports/held_out/run.json").write_text("{")
    require_same_sources(project / "reports/held_out", [other])
