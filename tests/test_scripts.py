"""The scripts for users: short, on public names alone; those in `studies/` print a table, draw a figure."""

import ast
import subprocess
import sys

import pytest

from needlefit.project.locate import shipped_folder

FOLDER = shipped_folder() / "studies"
SCRIPTS = [*sorted(FOLDER.glob("*.py")), shipped_folder() / "docs/examples/openigtlink.py"]
ANALYSES = (
    *("adaptation", "calibration", "calibration_synthetic", "closed_loop", "comparison", "next_insertion"),
    *("seeds", "sensitivity"),
)
PUBLIC = {"needlefit", "needlefit.api"}


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_is_short_and_imports_public_names_alone(path):
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    assert text.count("\n") <= (120 if path.parent == FOLDER else 150)
    assert f"{path.parent.name}/{path.name}" in str(ast.get_docstring(tree))
    modules = [one.name for node in ast.walk(tree) if isinstance(node, ast.Import) for one in node.names]
    modules += [str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert {one for one in modules if one.startswith("needlefit")} <= PUBLIC
    private = [node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    assert not [one for one in private if one.startswith("_")]


@pytest.mark.sweep
@pytest.mark.parametrize("name", ANALYSES)
def test_a_quick_run_prints_its_table_and_saves_its_figure(name, world):
    command = [sys.executable, str(FOLDER / f"{name}.py"), "--quick"]
    done = subprocess.run(command, cwd=world.folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) >= 4
    assert (world.folder / "reports" / f"{name}.png").stat().st_size > 5_000
