"""The command line as a user meets it: exit codes, streams, names, messages."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import pytest

from needlefit.cli import main
from needlefit.cli.exit_codes import Invocation, report_error
from needlefit.errors import ConfigError, DataError, FitError, ModelError

COMMANDS = (
    *(
        "simulate",
        "check",
        "tune",
        "identify",
        "calibrate",
        "predict",
        "validate",
        "verify",
        "material",
        "paper",
    ),
    *("init", "reconstruct", "twin", "new"),
)
MODULES = ("simulate", "check", "studies", "results", "reconstruct", "view", "import_data", "start")


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as leaving:
        main(words)
    return int(leaving.value.code or 0)


def python(code: str, *words: str, **kwargs: object) -> subprocess.CompletedProcess[str]:
    command: Sequence[str] = [sys.executable, "-c", code, *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, **kwargs)  # type: ignore[call-overload]


def test_help_names_every_command(capsys):
    assert run("--help") == 0
    out = capsys.readouterr().out
    assert all(f"\n  {command} " in out for command in COMMANDS)


@pytest.mark.parametrize("command", [*COMMANDS[:10], "twin build", "twin ct", "new dataset"])
def test_every_command_has_help(command, capsys):
    assert run(*command.split(), "--help") == 0
    assert f"Usage: needlefit {command}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "libraries", "modules"),
    [
        (("--version",), {"typer"}, set()),
        (("--help",), {"typer"}, set(MODULES)),
        (("simulate", "phantom1"), {"numpy", "pydantic", "rich", "typer"}, {"simulate"}),
        (("simulate", "phantom1", "--json"), {"numpy", "pydantic", "typer"}, {"simulate"}),
    ],
)
def test_a_command_imports_what_it_uses(words, libraries, modules):
    code = (
        "import json, sys, needlefit.cli\n"
        "try: needlefit.cli.main(sys.argv[1:])\n"
        "finally: print(json.dumps(list(sys.modules)), file=sys.__stdout__)"
    )
    done = python(code, *words)
    assert done.returncode == 0, done.stderr
    loaded = set(json.loads(done.stdout.splitlines()[-1]))
    assert loaded & list_required_modules() == libraries
    assert {name for name in MODULES if f"needlefit.cli.{name}" in loaded} == modules


def list_required_modules() -> set[str]:
    """Return the top-level modules of all packages that needlefit requires, those of its extras too."""
    names = {re.match(r"[\w.-]+", one)[0].lower() for one in metadata.requires("needlefit")} - {"needlefit"}
    found = metadata.packages_distributions()
    return {module for module, packages in found.items() if names & {one.lower() for one in packages}}


def test_version(capsys):
    from needlefit import __version__

    assert run("--version") == 0
    assert capsys.readouterr().out == f"needlefit {__version__}\n"


@pytest.mark.parametrize("words", [("nothing",), ("simulate",), ("simulate", "phantom1", "--depth", "deep")])
def test_usage_errors_exit_2(words, capsys):
    assert run(*words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Usage: needlefit" in captured.err


@pytest.mark.parametrize(("kind", "code"), [(ConfigError, 3), (DataError, 3), (ModelError, 4), (FitError, 4)])
def test_an_error_has_what_where_expected_and_fix(kind, code, capsys):
    error = kind("the depth is negative", where="a.toml", expected="a depth above 0", fix="change it")
    assert report_error(error, Invocation(())) == code
    assert capsys.readouterr().err == (
        f"needlefit: {error.where}: {error.what}\n  expected: {error.expected}\n  fix: {error.fix}\n"
    )


def test_an_unexpected_error_is_one_line_and_a_hint(capsys):
    assert report_error(ZeroDivisionError("division by zero"), Invocation(())) == 1
    err = capsys.readouterr().err
    assert err.startswith("needlefit: ") and err.count("\n") == 1
    assert "ZeroDivisionError: division by zero" in err and "-v" in err


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no folder that nobody may write to")
@pytest.mark.parametrize(
    "words", [("init", "x"), ("new", "dataset", "./x"), ("simulate", "phantom1", "--plot", "x.png")]
)
def test_an_unwritable_path_is_named(words, monkeypatch, capsys):
    monkeypatch.chdir("/proc")
    assert run(*words) == 3
    captured = capsys.readouterr()
    assert captured.out == "" and "unexpected" not in captured.err
    assert all(part in captured.err for part in ("x", "cannot be", "fix: "))


def test_an_error_of_the_system_is_not_unexpected(capsys):
    error = PermissionError(13, "Permission denied", "/locked/run.json")
    assert report_error(error, Invocation(())) == 3
    err = capsys.readouterr().err
    assert err.startswith("needlefit: /locked/run.json: ") and "Permission denied\n" in err
    assert "fix: " in err and "unexpected" not in err


def test_verbose_shows_the_traceback(capsys):
    assert run("simulate", "phantom9") == 3
    assert "Traceback" not in capsys.readouterr().err
    assert run("simulate", "phantom9", "-v") == 3
    assert "Traceback" in capsys.readouterr().err


def test_an_unknown_name_lists_the_nearest(capsys):
    assert run("simulate", "phantm1") == 3
    err = capsys.readouterr().err
    assert "phantm1" in err and re.search(r"expected: .*\bphantom1\b", err)


def test_ctrl_c_exits_130(capsys):
    assert report_error(KeyboardInterrupt(), Invocation(())) == 130


def test_a_closed_pipe_is_no_error():
    code = "import needlefit.cli; needlefit.cli.main(['paper'])"
    running = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert running.stdout is not None and running.stderr is not None
    running.stdout.close()
    assert (running.stderr.read(), running.wait()) == ("", 0)
    running.stderr.close()


@pytest.mark.sweep
def test_no_escape_codes_in_a_pipe_even_if_colour_is_asked_for():
    done = python(
        "import needlefit.cli; needlefit.cli.main(['paper'])",
        env={**os.environ, "NO_COLOR": "1", "FORCE_COLOR": "1"},
    )
    assert done.returncode == 0
    assert "\x1b[3" not in done.stdout and "\x1b[9" not in done.stdout


@pytest.mark.parametrize(
    "words", [("--h\u202eut",), ("report", "--o\u202eut"), ("simulate", "x", "y\x1b[2J")]
)
def test_control_characters_of_a_wrong_option_are_escaped(words, capsys):
    assert run(*words) == 2
    printed = capsys.readouterr().err
    assert printed.replace("\n", "").isprintable()
    assert "\\u202e" in printed or "\\x1b" in printed


def test_paper_prints_tables_and_contradictions(capsys):
    assert run("paper") == 0
    out = capsys.readouterr().out
    assert "2.82" in out and "Contradictions" in out
    assert run("paper", "--json") == 0
    tables = json.loads(capsys.readouterr().out)
    assert tables["validation"][5]["te_mm"] == 2.82
    assert any("9 + 5" in claim["statement"] for claim in tables["contradictions"])


def test_module_is_the_command(tmp_path: Path):
    done = subprocess.run(
        [sys.executable, "-m", "needlefit", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("needlefit ")


def test_completion_offers_names():
    from needlefit.cli.options import complete_scenes, complete_studies

    assert complete_scenes("phantom2") == ["phantom2", "phantom2_by_layers"]
    assert "all" in complete_studies("a")
