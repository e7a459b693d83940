"""The wheel: built, installed into an empty place, used from an empty folder."""

import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest

import needlefit
from needlefit.project.locate import shipped_folder
from needlefit.project.troubleshooting import read_sections

ROOT = shipped_folder()
pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="not run from the repository")
TEN_MB = 10 * 2**20


def call(*command: str, **kwargs: object) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, **kwargs)  # type: ignore[call-overload]
    assert done.returncode == 0, done.stdout + done.stderr
    return str(done.stdout)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    call(
        sys.executable,
        "-m",
        "build",
        "--no-isolation",
        "--wheel",
        "--sdist",
        "--outdir",
        str(folder),
        str(ROOT),
    )
    return folder


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the environment in which the wheel comes first."""
    target = tmp_path_factory.mktemp("site")
    (wheel,) = built.glob("*.whl")
    call(sys.executable, "-m", "pip", "install", "--no-deps", "--quiet", "--target", str(target), str(wheel))
    return {**os.environ, "PYTHONPATH": str(target)}


def test_the_wheel_is_small(built):
    (wheel,) = built.glob("*.whl")
    assert wheel.stat().st_size <= TEN_MB


def test_the_wheel_holds_every_file_of_the_page(installed):
    """Whatever a file of the page names is there too: it needs no build, and nothing from elsewhere."""
    place = Path("needlefit/viewer/page")
    page = Path(installed["PYTHONPATH"]) / place
    here = {path.relative_to(ROOT / place) for path in (ROOT / place).rglob("*") if path.is_file()}
    assert {path.relative_to(page) for path in page.rglob("*") if path.is_file()} == here
    named = re.compile(r"""(?:from|import|url\(|new Worker\(new URL\()\s*["'](\./|\.\./)([^"']+)["']""")
    for path in page.rglob("*.js"):
        for up, name in named.findall(path.read_text()):
            assert (path.parent / up / name).is_file(), (path.name, name)
    assert [p.name for p in page.rglob("*") if p.is_file() and "https://" in p.read_text()] == []


def test_the_wheel_is_used_not_the_repository(installed, tmp_path):
    code = "import needlefit, needlefit.project.locate as p"
    code += "\nprint(needlefit.__file__)\nprint(p.shipped_folder())"
    package, project = call(sys.executable, "-c", code, env=installed, cwd=tmp_path).split()
    assert Path(package).is_relative_to(installed["PYTHONPATH"])
    assert Path(project) == Path(installed["PYTHONPATH"]) / "needlefit" / "_shipped"


def test_it_simulates_from_an_empty_folder(installed, tmp_path):
    out = call(
        sys.executable, "-m", "needlefit", "simulate", "phantom1", "--json", env=installed, cwd=tmp_path
    )
    assert json.loads(out)["converged"] is True
    assert list(tmp_path.iterdir()) == []


def test_it_finds_everything_that_ships(installed, tmp_path):
    code = (
        "from needlefit.project.locate import find_file, find_studies, list_names\n"
        "assert [name for name, _ in find_studies('all')] == [f'study{n}' for n in (1, 2, 3, 4, 5)]\n"
        "assert find_file('dataset', 'twin').is_file()\n"
        "from needlefit.project.locate import _PATTERNS\n"
        "print(*(f'{kind}/{name}' for kind in _PATTERNS for name in list_names(kind)))"
    )
    from needlefit.project import locate

    here = [f"{kind}/{name}" for kind in locate._PATTERNS for name in locate.list_names(kind)]
    assert set(call(sys.executable, "-c", code, env=installed, cwd=tmp_path).split()) == set(here)


def test_the_wheel_explains_warnings_files_terms_and_columns(installed, tmp_path):
    out = call(sys.executable, "-m", "needlefit", "explain", "--json", env=installed, cwd=tmp_path)
    assert {one["key"] for one in json.loads(out)} >= {*read_sections(), "study.toml", "stretch", "te_mm"}


def test_init_from_the_wheel_gives_a_project(installed, tmp_path):
    call(sys.executable, "-m", "needlefit", "init", "mine", env=installed, cwd=tmp_path)
    mine = tmp_path / "mine"
    assert {path.name for path in mine.iterdir()} == {"data", "configs", "studies"}
    wanted = {p.relative_to(ROOT) for p in (ROOT / "configs").rglob("*.toml")}
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


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == needlefit.__version__
    assert f"\nversion: {needlefit.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_public_names_resolve():
    for name in needlefit.__all__:
        assert getattr(needlefit, name) is not None
    assert set(needlefit.__all__) <= set(dir(needlefit))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = needlefit.nothing  # type: ignore[attr-defined]
