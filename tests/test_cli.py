"""The command line as a user meets it: exit codes, streams, names, messages, progress, and `check`."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections import Counter
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from needlefit.cli import execution, main, screen
from needlefit.cli.exit_codes import Invocation, report_error
from needlefit.cli.options import name_changes
from needlefit.errors import ConfigError, DataError, FitError, ModelError
from needlefit.project.locate import find_file
from needlefit.project.toml import dumps
from needlefit.reporting.table import TableColumn, TableLayout
from needlefit.studies.first_page import CHECKS

FULL = Path("/dev/full")
posix = pytest.mark.skipif(os.name != "posix", reason="redirections of a POSIX shell")


def run(line, *words):
    """Return the exit code of a command as it is typed, and of further words as they are."""
    with pytest.raises(SystemExit) as leaving:
        main([*shlex.split(line), *map(str, words)])
    return int(leaving.value.code or 0)


def shell(line, **environment):
    """Run a line of bash in which `needlefit` is the command; a failure anywhere in a pipe is its own."""
    line = f"set -o pipefail; {line.replace('needlefit', f'{sys.executable} -m needlefit')}"
    command = ["bash", "-c", line]
    return subprocess.run(command, capture_output=True, check=False, env={**os.environ, **environment})


def list_loaded(*words, **options):
    """Return the modules that a command has loaded."""
    code = (
        "import json, sys, needlefit.cli\n"
        "try: needlefit.cli.main(sys.argv[1:])\n"
        "finally: print(json.dumps(list(sys.modules)), file=sys.__stdout__)"
    )
    command = [sys.executable, "-c", code, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True, **options)
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize(
    ("words", "libraries"),
    [
        (("--help",), {"typer"}),
        (("simulate", "phantom1", "--json"), {"numpy", "pydantic", "typer"}),
    ],
)
def test_a_command_imports_what_it_uses(words, libraries):
    loaded = list_loaded(*words)
    names = {re.match(r"[\w.-]+", one)[0].lower() for one in metadata.requires("needlefit")} - {"needlefit"}
    found = metadata.packages_distributions()  # of the extras too
    required = {module for module, packages in found.items() if names & {one.lower() for one in packages}}
    assert loaded & required == libraries


def test_a_fit_loads_no_statistics_of_scipy(tmp_path):
    fit = find_file("fit", "chicken").read_text()
    (tmp_path / "quick.toml").write_text(fit.replace('"default"', '"quick"'))
    loaded = list_loaded("tune", "./quick.toml", "--no-sample", "--quiet", cwd=tmp_path)
    assert "scipy.stats" not in loaded  # 0.4 s
    assert {"matplotlib", "scipy.optimize"} <= loaded


@pytest.mark.parametrize(
    ("line", "code", "expected"),
    [
        ("nothing", 2, "Usage: needlefit"),
        ("tune study2 --sample", 2, "--sample"),
        ("simulate", 2, "Usage: needlefit"),
        ("simulate phantom1 --depth deep", 2, "Usage: needlefit"),
        ("--h\u202eut", 2, r"\\u202e"),
        ("report --o\u202eut", 2, r"\\u202e"),
        ("simulate x y\x1b[2J", 2, r"\\x1b"),
        ("simulate phantm1", 3, r"phantm1[\s\S]*expected: .*\bphantom1\b"),  # the nearest name
        ("predict ./nix --scene study2", 3, "no study or fit .*nix"),
        ("simulate phantom9", 3, "^(?![\\s\\S]*Traceback)"),
        ("-v simulate phantom9", 3, "Traceback"),
    ],
)
def test_a_wrong_command_line_has_its_exit_code(line, code, expected, capsys):
    assert run(line) == code
    captured = capsys.readouterr()
    assert captured.out == "" and re.search(expected, captured.err)
    assert captured.err.replace("\n", "").isprintable()


def test_what_is_changed_of_a_prediction_names_its_folder():
    assert name_changes(None, [], None) == ""
    assert name_changes(60.0, [], None) == "-depth_mm=60" == name_changes(None, ["depth_mm = 60"], None)
    assert name_changes(40.25, ["bevel.side=-1"], "same") == "-bevel.side=-1-depth_mm=40.25-specimen=same"
    assert name_changes(None, ["a=1", "b="], None) == name_changes(None, ["b=", "a=1"], None) == "-a=1-b="
    odd = [f"title={text}" for text in ("a/b", "a?b", "a_b", "x" * 300, "x" * 301)]
    names = [name_changes(None, [one], None) for one in odd]
    assert len({*names}) == len(names) and all(re.fullmatch(r"[\w.=-]{1,100}", name) for name in names)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        *((kind, 3) for kind in (ConfigError, DataError)),
        *((kind, 4) for kind in (ModelError, FitError)),
        (PermissionError(13, "Permission denied", "/locked/run.json"), 3),
        (KeyboardInterrupt(), 130),
        (MemoryError(), 3),
        (ModuleNotFoundError("No module named 'distributed'", name="distributed"), 3),
        (BrokenPipeError(32, "Broken pipe"), 3),  # of a worker: a reader of stdout that has gone raises none
        (ZeroDivisionError("division by zero"), 1),
    ],
)
def test_an_error_has_its_exit_code_and_what_where_expected_and_fix(error, code, capsys):
    is_own = isinstance(error, type)
    if is_own:
        error = error("negative", where="a.toml", expected="a depth above 0", fix="change it")
    assert report_error(error, Invocation(())) == code
    err = capsys.readouterr().err
    assert not is_own or err == "needlefit: a.toml: negative\n  expected: a depth above 0\n  fix: change it\n"
    assert ("unexpected" in err) == (code == 1)


# --- streams that are closed, full, broken, or of few characters --------------------


@posix
@pytest.mark.parametrize(
    ("line", "code", "in_out", "in_err"),
    [
        ("needlefit --version", 0, "^needlefit [0-9.]+\n$", "^$"),
        ("needlefit simulate phantom1 <&-", 0, "1.33", "^$"),
        ("needlefit simulate phantom1 >&- 2>&- <&-", 0, "^$", "^$"),
        ("(needlefit simulate phantom1 || [ $? = 1 ]) | head -1", 0, "^.*\n$", "^$"),
        ("PYTHONIOENCODING=ascii needlefit explain mu1_pa", 0, r"^[\x00-\x7f]*\?[\x00-\x7f]*$", "^$"),
        (f"needlefit simulate phantom1 > {FULL}", 3, "^$", r"^(?!.*Traceback)[\s\S]*No space left"),
    ],
)
def test_a_stream_that_is_lost_changes_no_exit_code(line, code, in_out, in_err):
    if str(FULL) in line and not FULL.exists():
        pytest.skip("this system has no /dev/full")
    done = shell(line)
    assert done.returncode == code
    assert re.search(in_out, done.stdout.decode()) and re.search(in_err, done.stderr.decode())


def test_the_time_left_is_known_after_a_quarter_of_the_work_of_this_run(monkeypatch):
    times = iter([0.0, 10.0, 20.0, 40.0, 3600.0])
    monkeypatch.setattr(execution, "time", SimpleNamespace(monotonic=lambda: next(times)))
    estimate_left = execution.begin_estimates()
    done = (20, 20, 39, 40, 60)  # an earlier run has done 20 of 100
    words = [estimate_left(count, 100) for count in done]
    assert words[:3] == ["", "", ""]
    assert [re.findall(r"\d+ \w+", text) for text in words[3:]] == [["2 min"], ["60 min"]]


def test_json_has_no_nan_and_a_table_in_a_pipe_is_never_cut(capsys):
    screen.show_json({"te_mm": float("nan"), "bound": float("inf"), "points": ((1.5, 2.0),), "name": "µ"})
    out = capsys.readouterr().out
    assert json.loads(out) == {"te_mm": None, "bound": None, "points": [[1.5, 2.0]], "name": "µ"}
    assert "µ" in out
    screen.show_frame(pd.DataFrame({"name": ["x" * 300, "short"], "te_mm": [2.82, float("nan")]}), "Title")
    out = capsys.readouterr().out
    assert "x" * 300 in out and "2.82" in out and "nan" not in out


# --- long runs: progress, Ctrl-C, and the line that goes on --------------------


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_second_signal_ends_what_never_asks_whether_to_stop(end):
    code = (
        "from needlefit.cli.exit_codes import Invocation, catch_interrupts\n"
        "with catch_interrupts(Invocation(('tune', 'gel'))):\n"
        "    print('ready', flush=True)\n"
        "    while True:\n"
        "        sum(range(1000))\n"
    )
    words, started = [sys.executable, "-c", code], time.monotonic()
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        running.stdout.readline()
        running.send_signal(end)
        running.stderr.read(10)  # the first one has been heard
        running.send_signal(end)
        assert running.wait(timeout=30) == 130
        assert b"needlefit tune gel --resume" in running.stderr.read()
    assert time.monotonic() - started < 30
    typed = ("tune", "my fits/gel.toml", "--seed", "3")
    assert shlex.split(Invocation(typed).resuming()) == ["needlefit", *typed, "--resume"]
    assert Invocation((*typed, "--resume")).resuming().count("--resume") == 1


# --- `needlefit check` --------------------

STUDY = {"schema": 2, "dataset": "twin", "medium": "chicken", "leave_out": "specimen"}
STUDY |= {"tune": {"medium": "chicken"}}


@pytest.mark.parametrize(
    "changes",
    [
        {"leave_out": "needle"},
        {"medium": "chiken"},
        {"recipe": "none"},
        {"tune": {"medium": "pork"}},
        {"tune": {"medium": "phantom1"}, "medium": "phantom1"},
        {"kind": "identification"},
        {"dataset": None, "medium": None, "leave_out": None},
        "schema = 1\nlayers = 1\n",  # of a tissue
    ],
)
def test_a_fault_of_a_study_is_named_with_its_file(tmp_path, changes, capsys):
    if isinstance(changes, dict):
        changes = dumps({key: value for key, value in (STUDY | changes).items() if value is not None})
    (tmp_path / "mine.toml").write_text(changes)
    assert run("check", tmp_path / "mine.toml") == 3
    assert "mine.toml" in capsys.readouterr().err


@pytest.mark.parametrize(("study", "reason"), [("study5", "few"), ("turned_planar", "plane")])
def test_a_check_of_a_study_states_why_its_needles_were_not_compared(
    tmp_path, study, reason, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert run("check", study) == 0
    shown = " ".join(capsys.readouterr().err.split())
    assert CHECKS.sentence("unjudged", {"unjudged": reason}) in shown


@pytest.mark.parametrize("width", [30, 44, 60, 80, 120])
def test_a_table_that_is_too_wide_breaks_no_word_and_loses_no_column_in_silence(width, monkeypatch, capsys):
    heads = ("Tissue", "Layers", "Specimen", "Depth mm", "Deflection mm", "Median mm", "IPE mm")
    heads += ("TE mm", "EDP %")
    columns = tuple(
        TableColumn(head, align="left" if n in (0, 2) else "right") for n, head in enumerate(heads)
    )
    row = ("phantom2", "3", "specimen-of-gelatine", "66.24", "10.31", "0.4123", "0.5", "1.2", "12.5")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", str(width))
    for count in (1, 2, 6):
        screen.show_display(TableLayout("a", "", columns, (row,) * count))
        out = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
        assert max(map(len, out.splitlines())) <= width
        words = Counter(out.replace(",", " ").split())
        for head, cell in zip(heads, row, strict=True):
            named = all(words[word] for word in head.split())
            assert named and (words[cell] == count or "Not shown" in out)
        widest = {1: 33, 2: 54, 6: 72}[count]  # turned, turned, as it is
        assert ("Not shown" in out) == (width < widest)
