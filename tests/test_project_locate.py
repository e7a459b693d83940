"""Names to files: the working folder's project first, then the shipped one."""

from pathlib import Path

import pytest

from needlefit.cli.start import copy_project
from needlefit.errors import ConfigError
from needlefit.project import locate

STUDY = "schema = 1\nvalidate = [{}]\n"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for part in ("studies", "configs/fits", "configs/scenes"):
        (tmp_path / part).mkdir(parents=True)
    (tmp_path / "studies/mine.toml").write_text(STUDY)
    (tmp_path / "configs/fits/gel.toml").write_text("schema = 1\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_working_folder_comes_first(project):
    (project / "configs/scenes/phantom1.toml").write_text("schema = 1\n")
    assert locate.find_file("scene", "phantom1") == project / "configs/scenes/phantom1.toml"
    assert locate.find_file("scene", "phantom2") == locate.shipped_folder() / "configs/scenes/phantom2.toml"
    assert "mine" in locate.list_names("study") and "phantom2" in locate.list_names("scene")


def test_messages_call_a_shipped_file_by_its_name_and_the_user_s_own_by_its_path(project, monkeypatch):
    own = project / "configs/scenes/phantom1.toml"
    own.write_text("schema = 1\n")
    assert locate.file_label(locate.find_file("scene", "phantom1")) == str(own)
    assert locate.file_label(locate.find_file("scene", "phantom2")) == "scene phantom2 (shipped)"
    assert locate.file_label(locate.find_file("dataset", "twin")) == "dataset twin (shipped)"
    assert locate.file_label(locate.find_file("study", "study3")) == "study study3 (shipped)"
    monkeypatch.chdir(locate.shipped_folder())  # then the shipped files are what the user works on
    assert locate.file_label(locate.find_file("scene", "phantom2")).endswith("configs/scenes/phantom2.toml")


def test_an_empty_folder_uses_the_shipped_project(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert locate.search_roots() == (locate.shipped_folder(),)
    assert locate.find_file("scene", "study3").is_file()


def test_targets_are_studies_or_fits(project):
    assert locate.find_study_or_fit("mine") == ("study", project / "studies/mine.toml")
    assert locate.find_study_or_fit("gel") == ("fit", project / "configs/fits/gel.toml")
    assert locate.find_study_or_fit("studies/mine.toml") == ("study", Path("studies/mine.toml"))


def test_a_name_that_is_both_is_an_error(project):
    (project / "studies/gel.toml").write_text(STUDY)
    with pytest.raises(ConfigError, match="`gel`") as fault:
        locate.find_study_or_fit("gel")
    assert "studies/gel.toml" in fault.value.fix and "configs/fits/gel.toml" in fault.value.fix


def test_a_missing_path_is_no_unknown_name(project):
    with pytest.raises(ConfigError, match="no such study"):
        locate.find_study_or_fit("studies/none.toml")
    with pytest.raises(ConfigError, match="no such scene"):
        locate.find_file("scene", "./none.toml")


def test_a_folder_of_that_name_is_pointed_out(project):
    (project / "needles").mkdir()
    with pytest.raises(ConfigError, match=r"write \./needles"):
        locate.find_file("dataset", "needles")


def test_a_dataset_may_be_named_by_its_folder(project):
    (project / "gel").mkdir()
    (project / "gel/dataset.toml").write_text("")
    assert locate.find_file("dataset", "./gel") == Path("gel/dataset.toml")


def test_all_means_the_five_of_the_paper():
    assert [name for name, _ in locate.find_studies("all")] == [f"study{n}" for n in (1, 2, 3, 4, 5)]


def test_one_study_is_called_by_its_file(project):
    assert locate.find_studies("mine") == [("mine", project / "studies/mine.toml")]
    assert locate.find_studies("studies/mine.toml") == [("mine", Path("studies/mine.toml"))]
    with pytest.raises(ConfigError, match=r"study .*`al`") as fault:
        locate.find_studies("al")
    assert "all" in fault.value.expected


def test_a_fit_is_no_study_and_the_command_for_it_is_named(project):
    (project / "configs/fits/my gel.toml").write_text("schema = 1\n")
    for name, written in (("gel", "gel"), ("my gel", "'my gel'"), ("./configs/fits/gel.toml",) * 2):
        with pytest.raises(ConfigError, match="is a fit") as fault:
            locate.find_studies(name)
        assert fault.value.fix == f"use: needlefit tune {written}"
    with pytest.raises(ConfigError, match="`all`") as fault:
        locate.find_study_or_fit("all")
    assert "needlefit validate all" in fault.value.fix and "study1" in fault.value.expected


def test_a_folder_without_dataset_toml_is_an_error(project):
    (project / "gel").mkdir()
    with pytest.raises(ConfigError, match=r"no dataset\.toml"):
        locate.find_file("dataset", "./gel")
    with pytest.raises(ConfigError, match=r"no dataset\.toml"):
        locate.find_file("dataset", ".")


def test_a_run_is_a_folder_with_run_json(project):
    (project / "reports/study3").mkdir(parents=True)
    with pytest.raises(ConfigError, match="no run called"):
        locate.find_run("study3")
    (project / "reports/study3/run.json").write_text("{}")
    assert locate.find_run("study3") == Path("reports/study3")
    assert locate.find_run("./reports/study3") == Path("reports/study3")


def test_init_copies_once_and_never_overwrites(tmp_path, monkeypatch):
    copy_project(tmp_path / "mine")
    monkeypatch.chdir(tmp_path / "mine")
    assert locate.find_file("scene", "chicken") == tmp_path / "mine/configs/scenes/chicken.toml"
    with pytest.raises(ConfigError, match="exists already"):
        copy_project(tmp_path / "mine")


def test_all_names_are_listed_the_nearest_first(project):
    for part in range(4):
        (project / f"reports/run{part}").mkdir(parents=True)
        (project / f"reports/run{part}/run.json").write_text("{}")
    with pytest.raises(ConfigError) as fault:
        locate.find_run("run1x")
    assert fault.value.expected.startswith("one of run1, ") and "run0" in fault.value.expected
    for wanted in ("study33", "STUDY3", "study3.tml"):
        with pytest.raises(ConfigError) as fault:
            locate.find_studies(wanted)
        listed = fault.value.expected.removeprefix("one of ").split(", ")
        assert listed[0] == "study3" and sorted(listed) == sorted(
            [*locate.list_names("study"), "all", "everything"]
        )


@pytest.mark.parametrize("ending", ["tml", "tom", "TOML", "tmol", "toml~"])
def test_a_misspelt_ending_is_taken_for_a_path(project, ending):
    (project / "mine.toml").write_text(STUDY)
    for find, name in (
        (locate.find_studies, f"mine.{ending}"),
        (locate.find_study_or_fit, f"./mine.{ending}"),
        (lambda name: locate.find_file("scene", name), f"mine.{ending}"),
    ):
        with pytest.raises(ConfigError) as fault:
            find(name)
        assert "./mine.toml" in fault.value.fix
    with pytest.raises(ConfigError) as fault:
        locate.find_file("scene", f"./mine.{ending}")
    assert fault.value.expected.endswith("mine.toml")


def test_a_long_list_of_names_is_cut():
    assert locate.join_names([str(n) for n in range(45)]).endswith("and 5 more")
