"""What holds of a run of every kind of study: files, stored results, report, and the same bytes each time."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import chdir

import pytest
from made_again import assert_made_again, read_files
from world import COMMANDS, find_words

from needlefit.studies.kind import KINDS
from needlefit.studies.run import read_run
from needlefit.studies.run_differences import compare_runs

EVERY = pytest.mark.parametrize("kind", list(COMMANDS))
WRITTEN = {"needlefit.json", "report.html", "report.pdf", "results.json.gz", "run.json", "timing.json"}
ELSEWHERE = {
    "PYTHONHASHSEED": "2",
    "TZ": "Pacific/Kiritimati",
    "LC_ALL": "POSIX",
    "PYTHONCOERCECLOCALE": "0",
    "PYTHONUTF8": "0",  # files whose encoding is not named are then ASCII
    "PYTHONIOENCODING": "utf-8",
    "SOURCE_DATE_EPOCH": "1",
    "COLUMNS": "40",
    "OPENBLAS_NUM_THREADS": "2",
}
"""Hash seed, time zone, locale, encodings, the width of a terminal, and a setting that must not be heeded."""


@EVERY
def test_a_run_has_its_files_and_frames(world, kind):
    folder, frames = world.find(kind), world.restore(kind).frames
    of = COMMANDS[kind].kind or kind
    for name, columns in KINDS[of].frames.items():
        assert {*columns} <= {*frames[name]}, name
    names = {path.name for path in folder.iterdir()}
    assert names >= WRITTEN
    assert all(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    assert read_run(folder)["kind"] == of


@EVERY
def test_files_name_neither_folder_nor_time_and_rows_name_their_origin(world, kind):
    folder = world.find(kind)
    hidden = (str(world.folder).encode(), b"CreationDate", b"ModDate")
    for name, content in read_files(folder).items():
        assert not [one for one in hidden if one in content], name
    origin = world.restore(kind).origin
    for path in folder.glob("*.csv"):
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
        assert {row["origin"] for row in rows if "origin" in row} <= {origin, "none"}


@EVERY
def test_a_run_is_written_again_from_its_stored_results_and_differs_in_nothing(world, kind):
    folder = world.find(kind)
    with chdir(world.folder):
        again = assert_made_again(folder, has_data=kind == "reconstruction")
    assert compare_runs(folder, again).empty


@pytest.mark.sweep
@EVERY
def test_a_run_that_is_killed_resumes_to_the_same_bytes_with_other_jobs_in_other_surroundings(world, kind):
    if kind == "reconstruction":
        pytest.skip("a reconstruction is made anew")
    expected, out = read_files(world.find(kind)), world.folder / f"resumed-{kind}"
    for other in COMMANDS[kind].after:
        shutil.copytree(world.find(other), out / COMMANDS[other].folder)
    words = [sys.executable, "-m", "needlefit", *find_words(kind, out, jobs=2), "-q"]
    where = {"cwd": world.folder, "env": {**os.environ, **ELSEWHERE}}
    running = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **where)
    while running.poll() is None and not any(one.stat().st_size for one in out.glob("*.partial/*.jsonl")):
        time.sleep(0.005)
    running.send_signal(signal.SIGKILL)
    running.wait()
    resumed = subprocess.run([*words, "--resume"], capture_output=True, text=True, check=False, **where)
    assert resumed.returncode in COMMANDS[kind].codes, resumed.stderr
    found = read_files(out / COMMANDS[kind].folder)
    assert found.keys() == expected.keys()
    assert [name for name in expected if found[name] != expected[name]] == []
