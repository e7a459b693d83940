"""The example at the end of each command's help runs."""

import shutil

import openpyxl
import pytest
import typer
from test_cli import run
from test_cli_foreign_files import leave_run, stubs  # noqa: F401
from test_datasets import write_mine

from needlefit.cli.application import build
from needlefit.project.locate import shipped_folder

LESS = {
    "import": ("--yes",),
    "view": ("--no-browser",),
}
"""Words that make an example shorter, or ask nothing."""
SLOW = {"plan", "predict", "reconstruct", "tune", "validate"}


def list_examples():
    """Yield every command and its example."""
    for name, command in typer.main.get_command(build()).commands.items():
        inside = getattr(command, "commands", {"": command})
        for word, one in inside.items():
            _, _, example = one.epilog.partition("Example: needlefit ")
            yield f"{name} {word}".strip(), example


@pytest.mark.parametrize(
    ("command", "line"),
    [
        pytest.param(command, line, marks=[pytest.mark.sweep] if command in SLOW else [], id=command)
        for command, line in list_examples()
    ],
)
@pytest.mark.usefixtures("stubs")
def test_the_example_of_a_command_runs(command, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    book = openpyxl.Workbook()
    for row in [("x_mm", "y_mm", "z_mm"), *((x, 4e-4 * x**2, 0) for x in range(40))]:
        book.active.append(row)
    book.save("curves.xlsx")
    shutil.copytree(shipped_folder() / "data/sample_scan", tmp_path, dirs_exist_ok=True)
    leave_run(tmp_path / "reports/study3")
    leave_run(tmp_path / "old/study3")
    if command == "check":
        write_mine(tmp_path / "mydata")
    assert line.startswith(command)
    assert run(line, *LESS.get(command, ())) == 0, capsys.readouterr().err
