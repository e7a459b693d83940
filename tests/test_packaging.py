"""The wheel and the source archive: built, and what they hold."""

import os
import subprocess
import sys
import tarfile
import tomllib
import zipfile

import pytest

import needlefit
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


def test_the_wheel_holds_every_file_of_the_page_and_all_configurations(built):
    """`.ci/pythons` installs it and uses it from another folder."""
    (wheel,) = built.glob("*.whl")
    assert wheel.stat().st_size <= TEN_MB
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
    page = (path.relative_to(ROOT) for path in (ROOT / "needlefit/viewer/page").rglob("*") if path.is_file())
    shipped = ("needlefit/_shipped" / path.relative_to(ROOT) for path in (ROOT / "configs").rglob("*.toml"))
    assert {*map(str, page), *map(str, shipped)} <= inside


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
