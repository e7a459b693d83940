"""The true command with streams that are closed, full, broken, or of few characters."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from needlefit.cli.exit_codes import Invocation, report_error

NEEDLEFIT = f"{sys.executable} -m needlefit"
FULL = Path("/dev/full")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="redirections of a POSIX shell")


def shell(line: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run a line of bash in which `needlefit` is the command; a failure anywhere in a pipe is its own."""
    line = f"set -o pipefail; {line.replace('needlefit', NEEDLEFIT)}"
    command = ["bash", "-c", line]
    return subprocess.run(command, capture_output=True, check=False, env={**os.environ, **environment})


@pytest.mark.sweep
@pytest.mark.parametrize(("words", "lines"), [("paper --json | head -1", 1), ("--help | true", 0)])
def test_a_pipe_closed_early_is_no_failure(words, lines):
    done = shell(f"needlefit {words}")
    assert (done.returncode, done.stderr, done.stdout.count(b"\n")) == (0, b"", lines)


@pytest.mark.parametrize("closed", [pytest.param("<&-", marks=pytest.mark.sweep), ">&- 2>&- <&-"])
def test_closed_streams_change_no_exit_code(closed):
    done = shell(f"needlefit paper {closed}")
    assert (done.returncode, done.stderr, bool(done.stdout)) == (0, b"", closed == "<&-")


@pytest.mark.parametrize("lost", ["2>&-", "2>/dev/full"])
def test_without_stderr_a_fault_still_has_its_exit_code(lost):
    assert shell(f"needlefit simulate nonsense {lost}").returncode == 3


@pytest.mark.sweep
@pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("words", ["paper", "--help"])
def test_output_on_a_full_disk_is_an_error(words):
    done = shell(f"needlefit {words} > {FULL}")
    assert done.returncode == 3
    assert b"No space left" in done.stderr and b"Traceback" not in done.stderr


@pytest.mark.sweep
def test_characters_unknown_to_the_terminal_are_replaced(tmp_path):
    done = shell("needlefit paper", PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, b"") and done.stdout.isascii()
    assert b"?" in done.stdout
    (tmp_path / "scène.toml").write_text("schema = 1\nµ = 1\n", encoding="utf-8")
    done = shell(f"needlefit simulate {tmp_path}/scène.toml", PYTHONIOENCODING="ascii")
    assert done.returncode == 3 and b"unexpected" not in done.stderr


def test_json_for_an_ascii_terminal_loses_no_character():
    done = shell("needlefit paper --json", LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    assert done.stdout.isascii() and not json.dumps(json.loads(done.stdout), ensure_ascii=False).isascii()


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (MemoryError(), 3),
        (RecursionError(), 3),
        (UnicodeEncodeError("utf-8", "\udcff", 0, 1, "surrogates not allowed"), 3),
        (BrokenPipeError(32, "Broken pipe"), 3),  # of a worker: a reader of stdout that has gone raises none
    ],
)
def test_exceptions_of_python_have_a_message_and_an_exit_code(error, code, capsys):
    assert report_error(error, Invocation(())) == code
    assert "unexpected" not in capsys.readouterr().err
