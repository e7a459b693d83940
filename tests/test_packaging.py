"""The wheel: built, installed into an empty place, used from an empty folder."""

import json
import os
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest

import needlefit
from needlefit.project.help_pages import read_sections
from needlefit.project.locate import shipped_folder

ROOT = shipped_folder()
pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="not run from the repository")
TEN_MB = 10 * 2**20


def call(*command, **kwargs):
    done = subprocess.run(command, capture_output=True, text=True, check=False, **kwargs)  # type: ignore[call-overload]
    assert done.returncode == 0, done.stdout + done.stderr
    return str(done.stdout)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dist")
    words = ("build", "--no-isolation", "--wheel", "--sdist", "--outdir", str(folder), str(ROOT))
    call(sys.executable, "-m", *words)
    return folder


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """Return the environment in which the wheel comes first."""
    target = tmp_path_factory.mktemp("site")
    (wheel,) = built.glob("*.whl")
    call(sys.executable, "-m", "pip", "install", "--no-deps", "--quiet", "--target", str(target), str(wheel))
    return {**os.environ, "PYTHONPATH": str(target)}


def test_the_wheel_holds_every_file_of_the_page(installed):
    place = Path("needlefit/viewer/page")
    page = Path(installed["PYTHONPATH"]) / place
    here = {path.relative_to(ROOT / place) for path in (ROOT / place).rglob("*") if path.is_file()}
    assert {path.relative_to(page) for path in page.rglob("*") if path.is_file()} == here


def test_the_wheel_is_used_from_an_empty_folder(built, installed, tmp_path):
    (wheel,) = built.glob("*.whl")
    assert wheel.stat().st_size <= TEN_MB
    code = "import needlefit, needlefit.project.locate as p"
    code += "\nprint(needlefit.__file__)\nprint(p.shipped_folder())"
    package, project = call(sys.executable, "-c", code, env=installed, cwd=tmp_path).split()
    assert Path(package).is_relative_to(installed["PYTHONPATH"])
    assert Path(project) == Path(installed["PYTHONPATH"]) / "needlefit" / "_shipped"

    def run(*words):
        return call(sys.executable, "-m", "needlefit", *words, env=installed, cwd=tmp_path)

    assert json.loads(run("simulate", "phantom1", "--json"))["converged"] is True
    keys = {*read_sections(), "stretch", "te_mm"}
    assert {one["key"] for one in json.loads(run("explain", "--json"))} >= keys
    assert list(tmp_path.iterdir()) == []
    run("new", "project", "mine")
    mine = tmp_path / "mine"
    assert {path.name for path in mine.iterdir()} == {"data", "configs", "studies"}
    wanted = {path.relative_to(ROOT) for path in (ROOT / "configs").rglob("*.toml")}
    assert {p.relative_to(mine) for p in (mine / "configs").rglob("*.toml")} == wanted


def test_the_source_archive_holds_the_project_and_no_results(built):
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        inside = {name.partition("/")[2] for name in tar.getnames()}
    assert {
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "needlefit/cli/__init__.py",
        "tests/test_packaging.py",
    } <= inside
    assert "data/paper/validation.csv" in inside and "configs/scenes/study3.toml" in inside
    strays = (".venv", "__pycache__", ".git/", ".partial", "reports/study")
    assert [name for name in inside if any(stray in name for stray in strays)] == []


@pytest.mark.on_demand
def test_one_command_builds_the_wheels_of_all_platforms(built, tmp_path):
    """Of the unpacked source archive, with the packages of this environment."""
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path, filter="data")
    (root,) = tmp_path.glob("needlefit-*")
    out = tmp_path / "dist"
    call(sys.executable, "hatch_build.py", str(out), cwd=root)
    tags = {wheel.name.split("-none-")[1].split("_")[0] for wheel in out.glob("*.whl")}
    assert tags == {"manylinux", "musllinux", "macosx", "win"} and len(list(out.glob("*.whl"))) == 7


@pytest.mark.on_demand
def test_a_study_runs_on_the_lower_bounds_of_the_dependencies(built, tmp_path):
    """Each dependency in the oldest version that is declared; what they need in turn is the newest."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    oldest = [bound.replace(">=", "==") for bound in project["dependencies"]]
    call(sys.executable, "-m", "venv", str(tmp_path / "venv"))
    python = str(tmp_path / "venv" / "bin" / "python")
    (wheel,) = built.glob("*.whl")
    call(python, "-m", "pip", "install", "--quiet", str(wheel), *oldest)
    elsewhere = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = ("-m", "needlefit", "validate", "study3", "--quiet", "--out", "reports")
    call(python, *words, env=elsewhere, cwd=tmp_path)
    assert (tmp_path / "reports" / "study3" / "report.pdf").is_file()


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == needlefit.__version__
    assert f"\nversion: {needlefit.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
