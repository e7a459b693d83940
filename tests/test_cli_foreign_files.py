"""Every command, with files of the user at every place that it writes: all of them are there afterwards."""

import dataclasses
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer
from credibility_cases import leave, results
from light_runs import draw_blank
from reporting_results import skip_figures, study
from test_cli import run
from test_cli_verify import GOOD
from test_project_checkpoint import HOLDS
from test_viewer_recording import recorded
from world import build_project

from needlefit.cli.application import build
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.folders import MANIFEST, find_foreign, write_manifest
from needlefit.project.locate import shipped_folder
from needlefit.verification import run as verification
from needlefit.viewer.steering import Change

SCANS = str(shipped_folder() / "data" / "sample_scan" / "scans.csv")
FOREIGN = (
    "notes.md",
    "thesis.docx",
    "errors_mine.csv",
    "slicer/mine.mrk.json",
    "quality/mine.pdf",
    "sub/a/b.csv",
)


EMPTY = "to be filled"
"""A folder of the user's that holds nothing yet."""


@dataclass(frozen=True)
class Case:
    """A command line, the folders that it replaces or removes, and its exit code."""

    words: tuple[str, ...]
    folders: tuple[str, ...] = ()
    code: int = 0


def studies(name: str) -> tuple[str, ...]:
    return (f"out/{name}", f"out/{name}.partial")


CASES = {
    "simulate": Case(
        ("simulate", "study2", "--plot", "out/n.pdf", "--csv", "out/n.csv", "--slicer", "out/n.mrk.json")
    ),
    "view": Case(("view", "study2", "--no-browser", "--out", "out")),
    "plan": Case(("plan", "study2", "--target", "40,1", "--recording", "out/plan.csv", "-q")),
    "check": Case(("check", "twin")),
    "diff": Case(("diff", "./out/run", "./out/run")),
    "paper": Case(("paper",)),
    "explain": Case(("explain", "coverage")),
    "tune": Case(("tune", "held_out", "--out", "out", "-q"), studies("held_out-tune")),
    "validate": Case(
        ("validate", "held_out", "--reference", "--out", "out", "-q"),
        (*studies("held_out"), "out/reference/held_out"),
    ),
    "identify": Case(("identify", "held_out", "--out", "out", "-q"), studies("identify-held_out")),
    "calibrate": Case(
        ("calibrate", "meat", "--replicates", "2", "--jobs", "1", "--out", "out", "-q"),
        studies("calibrate-meat"),
        code=5,
    ),
    "predict": Case(
        ("predict", "held_out", "--scene", "ahead", "--out", "out", "-q"),
        ("out/predict-held_out-ahead",),
    ),
    "report": Case(("report", "./out/run", "--out", "out/again"), ("out/again",)),
    "verify": Case(("verify", "--out", "out", "-q"), ("out/verification",)),
    "credibility": Case(("credibility", "./out/run", "--out", "out", "-q"), ("out/credibility-run",)),
    "material": Case(("material", "gel.csv", "--out", "out"), ("out/material-gel",)),
    "reconstruct": Case(("reconstruct", SCANS, "--out", "out/rr", "-q"), ("out/rr", "out/rr.partial")),
    "import": Case(("import", "curves.csv", "--out", "out/found", "--yes"), ("out/found",)),
    "init": Case(("init", "out/project"), ("out/project/data", "out/project/configs", "out/project/studies")),
    "twin build": Case(("twin", "build", "--out", "out/twin", "-q"), ("out/twin",)),
    "twin ct": Case(("twin", "ct", "sample", "--out", "out/ct", "-q", "--jobs", "1"), ("out/ct",)),
    "new dataset": Case(("new", "dataset", "out/data"), ("out/data",)),
    "new dataset --from": Case(("new", "dataset", "out/from", "--from", "curves.csv"), ("out/from",)),
    "view --recording": Case(("view", "--recording", "log.csv", "--no-browser", "--out", "out")),
    "simulate --recording": Case(
        (
            "simulate",
            "--recording",
            "log.csv",
            "--plot",
            "out/n.pdf",
            "--csv",
            "out/n.csv",
            "--slicer",
            "out/n.ply",
        )
    ),
}
STUBBED = {name for name in CASES if name.startswith(("twin build", "verify", "view"))}
"""Those that take long, or serve until they are ended."""
REFUSED = [(name, folder) for name, case in CASES.items() for folder in case.folders]


def commands(group: typer.core.TyperGroup, before: str = "") -> Iterator[str]:
    for name, command in group.commands.items():
        if isinstance(command, typer.core.TyperGroup):
            yield from commands(command, f"{before}{name} ")
        else:
            yield f"{before}{name}"


def test_every_command_has_a_case_here():
    assert {name.partition(" --")[0] for name in CASES} == set(commands(typer.main.get_command(build())))


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in sorted(folder.rglob("*"))}


def plant(folder: Path) -> dict[str, bytes]:
    for name in FOREIGN:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(f"mine: {folder / name}\n".encode())
    (folder / EMPTY).mkdir(exist_ok=True)
    return {str(folder / EMPTY): b""} | {str(folder / name): (folder / name).read_bytes() for name in FOREIGN}


class Stub:
    """Stands for the fitting."""

    @staticmethod
    def run(name, record, settings):
        open_checkpoint(settings.checkpoint, settings.resume, {"n": 1}).keep_row("a", {"b": 1})
        return dataclasses.replace(study(1), name=name, record=record)


async def steer(page, port, ready, until):
    """Stand for the server: one needle is steered by one step."""
    trial = page.trials.open("a")
    trial.act([Change("depth_mm", None, 10.0)])


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "project"
    build_project(folder)
    monkeypatch.chdir(folder)
    recorded(folder / "log.csv")
    points = "".join(f"{x},{4e-4 * x**2},0\n" for x in range(40))
    (folder / "curves.csv").write_text(f"x_mm,y_mm,z_mm\n{points}")
    (folder / "out").mkdir()
    return folder


@pytest.fixture
def stubs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("needlefit.studies.kinds.cross_validation.run.run", Stub.run)
    skip_figures(monkeypatch)  # seconds, and other tests' business
    draw_blank(monkeypatch)
    for name in ("compile_pdf", "compile_html"):
        monkeypatch.setattr(f"needlefit.reporting.document.{name}", lambda _: b"a page")
    monkeypatch.setattr(verification, "find_checks", lambda: GOOD)
    monkeypatch.setattr("needlefit.cli.view._server", lambda: steer)
    monkeypatch.setattr(
        "needlefit.synthetic.build.build_dataset", lambda folder, *_, **__: (folder / "a").touch()
    )


def leave_run(folder: Path, command: str) -> None:
    """Leave what the commands read that are about a run."""
    made = results() if command == "credibility" else study(1)
    leave(dataclasses.replace(made, name=folder.name), folder.parent)


@pytest.mark.parametrize(("command", "place"), REFUSED)
@pytest.mark.parametrize("whose", ["the user's", "a result"])
def test_folders_with_foreign_files_are_refused_before_the_run(command, place, whose, project, stubs, capsys):
    """The folder is the user's own, or one that needlefit wrote and the user added to."""
    folder = project / place
    if "./out/run" in CASES[command].words:
        leave_run(project / "out/run", command)
    plant(folder)
    if whose == "a result":
        shutil.rmtree(folder)
        (folder / "slicer").mkdir(parents=True)
        (folder / "slicer" / "a.ply").touch()
        write_manifest(folder)
        plant(folder)
    before = everything(project)
    assert run(*CASES[command].words) == 3
    assert everything(project) == before
    printed = capsys.readouterr().err
    assert any(name in printed for name in FOREIGN) or "exists already" in printed
    assert str(folder) in printed or place in printed


def beside(project: Path) -> dict[str, bytes]:
    """Plant files everywhere but in the folders that a command replaces."""
    found = plant(project) | plant(project / "out") | plant(project / "out/other")
    for place in (
        "out/held_out.partial.damaged-1",
        "out/rr.damaged-1",
        "out/view",
        "out/.rr.needlefit-mine",
        "out/reference",
    ):
        found |= plant(project / place)
    for name in ("out/n.obj", "out/n.png", "out/run.json", f"out/{MANIFEST}", "out/lock", "out/project.csv"):
        (project / name).write_bytes(b"held_out")
        found[str(project / name)] = b"held_out"
    return found


def carry_out(command: str, project: Path) -> None:
    case, planted = CASES[command], beside(project)
    if "./out/run" in case.words:
        leave_run(project / "out/run", command)
    # the second time what it wrote is replaced
    for _ in range(1 if command.startswith(("init", "new dataset", "import")) else 2):
        assert run(*case.words) == case.code
    for place in case.folders:
        assert place.endswith(".partial") or any((project / place).iterdir())
    assert not any((project / place).exists() for place in case.folders if place.endswith(".partial"))
    after = everything(project)
    assert {path: after.get(path) for path in planted} == planted


@pytest.mark.sweep
@pytest.mark.parametrize("command", CASES)
def test_other_files_in_the_folder_stay(command, project, request):
    if command in STUBBED:
        request.getfixturevalue("stubs")
    carry_out(command, project)


@pytest.mark.parametrize("place", ["out/held_out-tune", "out/held_out-tune.partial"])
def test_a_file_added_during_the_run_stays(place, project, stubs, monkeypatch, capsys):
    def run_and_plant(name, record, settings):
        results = Stub.run(name, record, settings)
        plant(project / place)
        return results

    monkeypatch.setattr("needlefit.studies.kinds.cross_validation.run.run", run_and_plant)
    partial = place.endswith(".partial")
    assert run(*CASES["tune"].words) == (0 if partial else 3)
    assert all((project / place / name).is_file() for name in FOREIGN)
    assert "notes.md" in capsys.readouterr().err
    assert (project / "out/held_out-tune/run.json").is_file() == partial


def test_a_recording_is_never_overwritten(project, stubs, monkeypatch):
    before = (project / "log.csv").read_bytes()
    assert run("view", "--recording", "log.csv", "--no-browser", "--out", "out") == 0
    assert (project / "log.csv").read_bytes() == before


def test_a_second_run_into_the_same_folder_is_refused(project, stubs, capsys):
    pytest.importorskip("fcntl")
    words = [sys.executable, "-c", HOLDS, "out/held_out-tune.partial"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
        assert first.stdout.readline() == b"holds\n"
        for more in ((), ("--resume",)):
            assert run(*CASES["tune"].words, *more) == 3
            printed = capsys.readouterr().err
            assert f"process {first.pid}" in printed and "held_out-tune.partial" in printed
        assert not (project / "out/held_out-tune").exists()
        first.stdin.close()
    assert run(*CASES["tune"].words) == 0


@pytest.mark.parametrize("when", ["before a row is kept", "before the results are written"])
def test_the_folder_is_removed_while_it_is_written(when, project, stubs, monkeypatch, capsys):
    def run_and_remove(name, record, settings):
        checkpoint = open_checkpoint(settings.checkpoint, settings.resume, {"n": 1})
        if when.startswith("before a row"):
            shutil.rmtree(project / "out")
        checkpoint.keep_row("a", {"b": 1})
        shutil.rmtree(project / "out")
        return dataclasses.replace(study(1), name=name, record=record)

    monkeypatch.setattr("needlefit.studies.kinds.cross_validation.run.run", run_and_remove)
    code = run(*CASES["tune"].words)
    printed = capsys.readouterr().err
    if when.startswith("before a row"):
        assert code == 3 and "held_out-tune.partial" in printed
    else:
        assert code == 0 and find_foreign(project / "out/held_out-tune") == []
    assert "Traceback" not in printed and "unexpected" not in printed


def test_the_folder_is_removed_while_the_results_are_written(project, stubs, monkeypatch, capsys):
    def remove(_: object) -> bytes:
        shutil.rmtree(project / "out")
        return b"a page"

    monkeypatch.setattr("needlefit.reporting.document.compile_pdf", remove)
    assert run(*CASES["tune"].words) == 3
    assert "unexpected" not in capsys.readouterr().err
