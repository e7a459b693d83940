"""Commands that the program prints run as they are printed; advice follows from findings."""

import re
import shlex
import shutil
from collections import deque
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import pytest
from reporting_results import print_nothing
from test_cli import run
from world import COMMANDS as KIND_COMMANDS

from needlefit.project.help_pages import read_sections
from needlefit.project.result_warnings import ResultWarning
from needlefit.studies.first_page import (
    COMMANDS,
    Check,
    Finding,
    advise,
    classify_doubt,
    find_failures,
    list_doubts,
)
from needlefit.studies.kinds.cross_validation import run as cross_validation

PRINTED = re.compile(r"(?:cd [^\n&]+ && )?needlefit (?!warning|unexpected)[a-z]+ [^`;()\n]*[^`;()\n.: ]")
RUN_AS_PRINTED = (0, 5)  # done, or too short to converge in every respect
BOOK = "new workbook 'my needles.xlsx'"
SHORT = (BOOK, "check held_out", "check data/needles/insertions.csv")
LONG = ("new project 'my project'", "check gel", "check points.csv", "validate gel", "tune design")
"""Command lines that print others."""
VALUES = {
    "specimen": "others",
    **{"dataset": "needles", "doubt": "copy", "doubt_title": "two insertions are the same"},
    **{"other_medium": "phantom1", "curve": "a straight line", "width": 13.0, "gain": 3.6},
    **{"target": "meat", "tip": "31.5,1.0", "scan": "sample"},
    "best": {"insertion": "needle-2", "depth_mm": 30.0, "nats": 0.2},
}


@pytest.fixture
def project(world, tmp_path, monkeypatch):
    """A copy of the tiny world's project with its runs, as the working folder.

    Its recipe is the tiny one by the name `default`, too. Figures and pages are empty.
    """
    for kind in KIND_COMMANDS:
        world.find(kind)  # before anything is light: other tests read them
    monkeypatch.setattr("webbrowser.open", lambda _: True)
    print_nothing(monkeypatch)
    folder = tmp_path / "project"
    shutil.copytree(world.folder, folder, ignore=shutil.ignore_patterns("*.partial"))
    shutil.copyfile(folder / "configs/recipes/tiny.toml", folder / "configs/recipes/default.toml")
    points = "".join(f"{x},{4e-4 * x**2},0\n" for x in range(40))
    (folder / "points.csv").write_text(f"x_mm,y_mm,z_mm\n{points}")
    monkeypatch.chdir(folder)
    return folder


def run_all_printed(first, capsys):
    """Run a command line, and all that it prints, and what those print; return those that were run.

    Each runs in the folder in which it was printed.
    """
    todo, done = deque([(f"needlefit {first}", Path.cwd())]), {}
    while todo:
        line, folder = todo.popleft()
        *moves, command = map(shlex.split, line.split(" && "))
        for _, place in moves:
            folder = folder / place
        with chdir(folder):
            done[line] = run(shlex.join(command[1:]))
        printed = "".join(capsys.readouterr())
        assert len(done) == 1 or done[line] in RUN_AS_PRINTED, f"{line}\n{printed}"
        known = {*done, *(one for one, _ in todo)}
        todo += [(one, folder) for one in dict.fromkeys(PRINTED.findall(printed)) if one not in known]
    return list(done)[1:]


@pytest.mark.sweep
@pytest.mark.parametrize("kind", list(KIND_COMMANDS))
@pytest.mark.usefixtures("project")
def test_the_commands_that_a_run_prints_run(kind, world, capsys):
    found = run_all_printed(f"report reports/{KIND_COMMANDS[kind].folder}", capsys)
    advice = world.restore(kind).first_page.advice
    assert advice is None or not advice.command or advice.format_command(Path("reports")) in found


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize("start", [*SHORT, *(pytest.param(line, marks=pytest.mark.sweep) for line in LONG)])
def test_the_commands_that_a_command_prints_run(start, world, monkeypatch, capsys):
    if start == BOOK:  # eight fits: another run stands for them
        found = world.restore("cross_validation")

        def rename(name, *_):
            return replace(found.with_metadata(name=name), name=name)

        monkeypatch.setattr(cross_validation, "run", rename)
    assert run_all_printed(start, capsys)


@pytest.mark.sweep
@pytest.mark.parametrize("finding", [one for one, command in COMMANDS.items() if command])
@pytest.mark.usefixtures("project")
def test_every_command_of_the_table_of_advice_runs(finding, capsys):
    command = advise([finding], VALUES, "scanned" if "scan" in finding else "held_out").format_command()
    assert run(command.removeprefix("needlefit ")) in RUN_AS_PRINTED, capsys.readouterr().err


@pytest.mark.usefixtures("project")
def test_the_commands_that_explain_prints_run(capsys):
    printed = "\n".join(part for topic in read_sections().values() for part in topic.paragraphs)
    named = re.findall(r"`(needlefit [^`]* [^`]*)`", printed)
    assert len(named) >= 2
    for command in named:
        assert run(command.removeprefix("needlefit ")) in RUN_AS_PRINTED, capsys.readouterr().err


def test_a_placeholder_is_no_doubt():
    kinds = ("placeholder", "assumed", "validity", "copy", "shared_residual", "copy")
    doubts = list_doubts(ResultWarning(kind, "what") for kind in kinds)
    assert [one.kind for one in doubts] == ["copy", "validity", "shared_residual", "assumed"]
    found = ["dataset_doubtful", "", "result_doubtful", "values_assumed"]
    assert list(map(classify_doubt, doubts)) == found
    assert advise([*found[3:], "beyond_noise"], VALUES).finding == "beyond_noise"


PASSED = {one: Finding(one, True, named="straight") for one in Check}


@pytest.mark.parametrize(
    ("failed", "comparison", "other_medium", "finding"),
    [
        ((), "", False, None),
        ((Check.CURVES, Check.NOISE), "curve_closer", False, "curve_closer"),
        ((Check.CURVES, Check.INTERVALS), "curve_closer", True, "other_medium_missed"),
        ((Check.NOISE,), "", True, "other_medium_missed"),
        ((Check.NOISE,), "", False, "beyond_noise"),
        ((Check.NOISE,), "one_needle_decides", False, "one_needle_decides"),
        ((Check.WIDTH, Check.NOISE), "", False, "intervals_wide"),
        ((Check.INTERVALS,), "", False, "intervals_miss"),
        ((Check.COVERAGE_50,), "", False, "intervals_miss"),
    ],
)
def test_advice_follows_from_the_checks(failed, comparison, other_medium, finding):
    checks = PASSED | {one: replace(PASSED[one], passed=False, value=1, threshold=3.5) for one in failed}
    advice = advise(find_failures(checks, comparison, other_medium), VALUES, "study")
    assert (advice and advice.finding) == finding


def test_doubts_stand_before_a_good_and_a_bad_word_and_wide_intervals_miss_nothing():
    wide = replace(PASSED[Check.COVERAGE_50], passed=False, value=7, threshold=3.5)
    assert find_failures(PASSED | {Check.COVERAGE_50: wide}, "", False) == find_failures(PASSED, "", False)
    for others in (["predictable"], ["curve_closer", "other_medium_missed"], []):
        assert advise(["dataset_doubtful", *others], VALUES).finding == "dataset_doubtful"
    assert advise([], VALUES) is None
