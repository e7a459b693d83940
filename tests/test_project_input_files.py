"""Reading what may be no file, no text, endless, or nested without end; finding files and runs by name."""

import os
import socket
import time
import tomllib
from contextlib import chdir
from pathlib import Path

import pytest
from refusals import refusal

from needlefit.cli.data import new_project
from needlefit.errors import ConfigError, DataError
from needlefit.project import locate
from needlefit.project.input_files import parse_json, parse_toml, read_bytes, read_json, read_text
from needlefit.project.toml import load
from needlefit.schemas.recipe import RecipeRecord


def refused(read, *arguments, error=DataError):
    found = refusal(error, "", read, *arguments)
    assert found.what and found.where and found.fix
    assert len(str(found)) < 2000
    return found


@pytest.fixture
def places(tmp_path):
    """Paths that exist and are no regular files, with what they are called."""
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    found = {"folder": tmp_path / "folder", "pipe": tmp_path / "pipe", "device": tmp_path / "link"}
    with socket.socket(socket.AF_UNIX) as one:
        with chdir(tmp_path):  # names of sockets are short
            one.bind("socket")
        yield found | {"socket": tmp_path / "socket"}


@pytest.mark.parametrize("kind", ["folder", "pipe", "device", "socket"])
def test_only_regular_files_are_opened(places, kind):
    refused(read_json, places[kind])


@pytest.mark.parametrize("name", ["a\0b", "x" * 300, "a/" * 3000, "gone", "\udcff", "a\nb\x1b[31m"])
def test_impossible_names_are_refused(tmp_path, name):
    error = refused(read_bytes, tmp_path / name)
    assert "\0" not in str(error) and "\x1b" not in str(error)
    for find in (locate.find_view_target, locate.find_study_or_fit, locate.find_run):
        refusal(ConfigError, "", find, f"./{name}")


def test_a_file_larger_than_the_limit_is_refused(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(bytes(2000))
    assert len(read_bytes(path, 2000)) == 2000
    refused(read_bytes, path, 1999)
    with path.open("r+b") as file:
        file.truncate(2**40)  # a hole: it takes no room
    assert "MiB" in refused(read_text, path).what


def test_a_file_without_a_size_is_limited_too():
    """Files of /proc have the size 0; what they hold counts."""
    whole = read_bytes(Path("/proc/self/status"))
    assert len(whole) > 100
    refused(read_bytes, Path("/proc/self/status"), 100)


@pytest.mark.parametrize("levels", [10_000, 100_000])
def test_nesting_without_end_is_refused(levels):
    refused(parse_json, "[" * levels + "1" + "]" * levels, "f")
    refused(parse_json, '{"a":' * levels + "1" + "}" * levels, "f")
    for text in ("[" * levels + "1" + "]" * levels, "{b=" * levels + "1" + "}" * levels):
        refused(parse_toml, f"a = {text}", "f", error=ConfigError)
    for key in ("a" + ".9" * levels, '"a"' + ' . "b"' * levels):
        began = time.process_time()
        refused(parse_toml, f"{key} = 1", "f", error=ConfigError)
        refused(parse_toml, f"x = {{{key} = 1}}", "f", error=ConfigError)
        assert time.process_time() - began < 1.0
    assert parse_toml("a = [" + "1.25, " * levels + '"' + ". " * levels + '"]', "f")


def test_a_file_of_a_later_schema_is_refused_and_left_alone(tmp_path):
    file, text = tmp_path / "recipe.toml", f"schema = {RecipeRecord.SCHEMA + 1}\n"
    file.write_text(text)
    fault = refusal(ConfigError, "", load, file, RecipeRecord)
    assert fault.where == str(file) and "`schema`" in fault.what and file.read_text() == text
    for schema in range(1, RecipeRecord.SCHEMA + 1):
        file.write_text(f"schema = {schema}\n")
        load(file, RecipeRecord)


@pytest.mark.parametrize("text", ["\x1b[2J", "\x1b]0;t\x07", "a\rb", "\x00", "\x9b31m", "\u202e", "\udcff"])
def test_control_characters_of_a_terminal_are_escaped(text):
    shown = str(DataError(f"is {text}", where=f"{text}.csv", expected=text, fix=text))
    assert shown.isprintable() or set("\n") == {c for c in shown if not c.isprintable()}
    assert text not in shown
    shown.encode("utf-8")


STUDY = "schema = 1\nvalidate = [{}]\n"


@pytest.fixture
def project(tmp_path, monkeypatch):
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


def test_a_name_that_is_both_is_an_error(project):
    (project / "studies/gel.toml").write_text(STUDY)
    fault = refusal(ConfigError, "`gel`", locate.find_study_or_fit, "gel")
    assert "studies/gel.toml" in fault.fix and "configs/fits/gel.toml" in fault.fix


def test_a_dataset_may_be_named_by_its_folder(project):
    (project / "gel").mkdir()
    refusal(ConfigError, r"no dataset", locate.find_file, "dataset", "./gel")
    (project / "gel/dataset.toml").write_text("")
    assert locate.find_file("dataset", "./gel") == Path("gel/dataset.toml")
    assert all(map(locate.is_path, (".", "..", "mine.toml"))) and not locate.is_path("mine")


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """A folder with a run in `reports`, one elsewhere, and a folder of two runs."""
    for run in ("reports/a", "b", "more/one", "more/two"):
        (tmp_path / run).mkdir(parents=True)
        (tmp_path / run / "run.json").write_text("{}")
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("a", "reports/a"), ("a/", "reports/a"), ("reports/a", "reports/a"), ("./reports/a/", "reports/a"),
        ("b", "b"), ("b/", "b"), ("./b", "b"),
    ],
)  # fmt: skip
def test_a_run_is_found_as_it_is_named(name, folder, runs):
    assert locate.find_run(name) == Path(folder)
    target = locate.find_view_target(name)
    assert (target.kind, target.path) == ("run", Path(folder))


@pytest.mark.parametrize(
    "name", ["chicken", "phantom1", "phantom2", "phantom3", *(f"study{n}" for n in range(1, 6))]
)
def test_a_name_of_a_scene_and_a_run_is_the_run_unless_the_scene_is_wanted(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = locate.find_view_target(name)
    (tmp_path / "reports" / name).mkdir(parents=True)
    (tmp_path / "reports" / name / "run.json").write_text("{}")
    run = locate.find_view_target(name)
    assert (run.kind, run.others) == ("run", (("scene", scene.path),))
    assert locate.find_view_target(name, "scene").path == scene.path == locate.find_file("scene", name)
    assert locate.find_view_target(str(scene.path)).kind == scene.kind == "scene"
    assert locate.find_run(name) == run.path


def test_an_insertion_of_a_run_is_found_and_several_runs_are_listed(runs):
    target = locate.find_view_target("./reports/a/needle-1")
    assert (target.path, target.insertion) == (Path("reports/a"), "needle-1")
    fault = refusal(ConfigError, "", locate.find_run, "more")
    assert "more/one" in fault.expected and "more/two" in fault.expected
    refusal(ConfigError, "`c`", locate.find_run, "c")


def test_init_copies_once_into_a_folder_of_its_own_and_never_overwrites(tmp_path, monkeypatch):
    new_project(tmp_path / "mine")
    monkeypatch.chdir(tmp_path / "mine")
    assert locate.find_file("scene", "chicken") == tmp_path / "mine/configs/scenes/chicken.toml"
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes/thesis.docx").touch()
    for folder in (Path("/"), *(tmp_path / name for name in (".", "notes", "notes/thesis.docx", "mine"))):
        refusal(ConfigError, "", new_project, folder)
    assert [path.name for path in (tmp_path / "notes").iterdir()] == ["thesis.docx"]


@pytest.mark.parametrize(
    "text",
    [
        "a = [[1, 2.5], [-3e2, 4]]\nb = [1_000]\n[t]\na = [1]",
        "[t]\na = [1]\n[t.u]\nb = [2]",
        'a = """\nb = [1]\n"""\nc = [2]',
        "a = [\n[1, 2],\n[3]]\nb = [ ]",
    ],
)
def test_arrays_at_the_top_of_a_file_are_those_that_toml_has(text):
    assert parse_toml(text, "file") == tomllib.loads(text)


@pytest.mark.parametrize("text", ["a = [1]\na = [2]", "a = [1]\na.b = 2", "a = [1]\n[a]\nb = 2", "a = [1 2]"])
def test_arrays_that_toml_has_not_are_refused(text):
    refused(parse_toml, text, "file", error=ConfigError)


@pytest.mark.parametrize("name", ["./study3", "Study3", "study3x", "studies/study3", "studies/study3.toml"])
def test_a_name_that_is_nearly_right_is_proposed(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for find in (locate.find_studies, locate.find_study_or_fit, locate.find_view_target):
        fault = refusal(ConfigError, "did you mean `study3`", find, name)
        assert fault.expected.startswith("one of study3, ")


def test_a_file_nearby_is_proposed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("gel").mkdir()
    Path("gel/gel_study.toml").touch()
    for find in (locate.find_studies, locate.find_study_or_fit):
        for name in ("gel_study", "./gel/gel_studi.toml"):
            refusal(ConfigError, r"did you mean `\./gel/gel_study\.toml`", find, name)
