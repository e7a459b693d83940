"""Long runs: progress, Ctrl-C, and the line that goes on."""

import io
import json
import os
import shlex
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest

from needlefit.cli import screen
from needlefit.cli.exit_codes import STOP_SIGNALS, Invocation, catch_interrupts
from needlefit.cli.progress import RemainingTime, format_remaining, report_lines, show_progress


def test_a_pipe_gets_one_line_a_minute():
    stream, times = io.StringIO(), iter([0.0, 1.0, 59.0, 60.0, 61.0, 119.0, 120.0])
    report = report_lines(stream, lambda: next(times))
    for done in range(6):
        report("study3: starts", done, 16)
    lines = stream.getvalue().splitlines()
    assert [line.split(": ") for line in lines] == [
        ["needlefit", "study3", "starts", f"{done} of 16, about {left} left"]
        for done, left in ((2, "7 min"), (5, "4 min"))
    ]


def test_the_remaining_time_follows_from_the_steps_so_far():
    times = iter([0.0, 5.0, 20.0, 40.0, 41.0, 60.0])
    remaining = RemainingTime(lambda: next(times))
    assert remaining.estimate(10, 100) is None  # what was resumed took no time
    assert remaining.estimate(20, 100) is None
    assert remaining.estimate(20, 100) == pytest.approx(160.0)
    assert remaining.estimate(0, 5) is None  # of other steps
    assert remaining.estimate(5, 100) is None  # begins again
    assert remaining.estimate(10, 100) == pytest.approx(19.0 * 90 / 5)


@pytest.mark.parametrize(("seconds", "words"), [(None, ""), (3.0, "10 s"), (95.0, "2 min"), (7300.0, "2 h")])
def test_the_remaining_time_is_rounded(seconds, words):
    assert words in format_remaining(seconds)


def test_quiet_prints_nothing(capsys):
    with show_progress(quiet=True) as report:
        report("study3", 1, 2)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_the_first_signal_sets_a_flag_and_restores_the_handler(number, capfd):
    before = signal.getsignal(number)
    with catch_interrupts(Invocation(("tune",))) as stop:
        assert not stop()
        os.kill(os.getpid(), number)
        assert stop()
    assert signal.getsignal(number) is before
    assert "stopping" in capfd.readouterr().err


def test_ctrl_c_twice_ends_at_once():
    code = (
        "import time\n"
        "from needlefit.cli.exit_codes import Invocation, catch_interrupts\n"
        "with catch_interrupts(Invocation(('tune', 'gel'))):\n"
        "    print('ready', flush=True)\n"
        "    time.sleep(60)\n"
    )
    running = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert running.stdout is not None and running.stderr is not None
    running.stdout.readline()
    started = time.monotonic()
    running.send_signal(signal.SIGINT)
    running.stderr.read(10)  # the first one has been heard
    running.send_signal(signal.SIGINT)
    assert running.wait(timeout=30) == 130
    assert b"needlefit tune gel --resume" in running.stderr.read()
    assert time.monotonic() - started < 30
    running.stdout.close()
    running.stderr.close()


def test_the_resuming_line_is_the_command_with_resume():
    typed = ("tune", "my fits/gel.toml", "--seed", "3")
    assert shlex.split(Invocation(typed).resuming()) == ["needlefit", *typed, "--resume"]
    assert Invocation((*typed, "--resume")).resuming().count("--resume") == 1


def test_json_has_no_nan(capsys):
    screen.show_json({"te_mm": float("nan"), "bound": float("inf"), "points": ((1.5, 2.0),), "name": "µ"})
    out = capsys.readouterr().out
    assert json.loads(out) == {"te_mm": None, "bound": None, "points": [[1.5, 2.0]], "name": "µ"}
    assert "µ" in out


def test_a_table_in_a_pipe_is_never_cut(capsys):
    frame = pd.DataFrame({"name": ["x" * 300, "short"], "te_mm": [2.82, float("nan")]})
    screen.show_frame(frame, "Title")
    out = capsys.readouterr().out
    assert "x" * 300 in out and "2.82" in out and "nan" not in out
