"""The wheel: built, installed into an empty place, used from an empty folder."""

import json
import os
import subprocess
import sys
import sysconfig
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


LOAD = "from needlefit.mechanics import native; native.load_library(); print(native.FOLDER)"


class Checkout:
    """The unpacked source archive, and an environment to install it into; HOME is a folder of its own."""

    def __init__(self, place, archive):
        with tarfile.open(archive) as tar:
            tar.extractall(place, filter="data")
        (self.root,) = place.glob("needlefit-*")
        self.folder = self.root / "needlefit" / "mechanics" / "native"
        self.home, self.python = place / "home", place / "venv" / "bin" / "python"
        self.home.mkdir()
        call(sys.executable, "-m", "venv", str(place / "venv"))
        cache = call(sys.executable, "-m", "pip", "cache", "dir").strip()
        kept = {
            name: value for name, value in os.environ.items() if not name.startswith(("NEEDLEFIT", "PYTHON"))
        }
        self.environment = kept | {"HOME": str(self.home), "PIP_CACHE_DIR": cache}

    def run(self, *words, **settings):
        return subprocess.run(
            [str(self.python), *words],
            cwd=self.home, env=self.environment | settings, capture_output=True, text=True, check=False,
        )  # fmt: skip

    def install(self, *words, **settings):
        return self.run("-m", "pip", "install", "--no-deps", *words, **settings)

    def use_packages_of_this_environment(self):
        """Let the new environment see what the tests run with: NumPy, hatchling, the compiler."""
        (site,) = self.root.parent.glob("venv/lib/python*/site-packages")
        (site / "tests.pth").write_text(sysconfig.get_path("purelib") + "\n")

    def load(self):
        self.use_packages_of_this_environment()
        return self.run("-c", LOAD)


@pytest.fixture
def checkout(built, tmp_path):
    (archive,) = built.glob("*.tar.gz")
    return Checkout(tmp_path, archive)


@pytest.mark.on_demand
def test_pip_installs_with_nothing_but_python_and_leaves_no_caches(checkout):
    """No compiler is on the PATH; that of the wheel keeps its files in a temporary folder."""
    done = checkout.install(str(checkout.root), PATH=str(checkout.python.parent))
    assert done.returncode == 0, done.stdout + done.stderr
    assert Path(checkout.load().stdout.strip()).is_relative_to(checkout.root.parent / "venv")
    assert list(checkout.home.iterdir()) == []


@pytest.mark.on_demand
def test_one_command_builds_the_wheels_of_all_platforms(checkout):
    checkout.use_packages_of_this_environment()
    out = checkout.home / "dist"
    done = subprocess.run(
        [str(checkout.python), "hatch_build.py", str(out)],
        cwd=checkout.root,
        env=checkout.environment,
        check=False,
    )
    assert done.returncode == 0
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
