"""What is written whole or not at all, also where a process is killed in the middle."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from needlefit.errors import ConfigError
from needlefit.project.atomic_write import replace_file, replace_folder

pytest.importorskip("fcntl")

WRITES = """
import sys
from pathlib import Path
from needlefit.project.atomic_write import {verb}
with {verb}(Path(sys.argv[1])) as fresh:
    print("writing", flush=True)
    sys.stdin.read()
"""


def writing(place: Path, verb: str) -> subprocess.Popen:
    """A process in the middle of writing `place`."""
    words = [sys.executable, "-c", WRITES.format(verb=verb), str(place)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"writing\n"
    return process


def end(process: subprocess.Popen, how: int) -> None:
    os.kill(process.pid, how)
    process.wait(10)
    process.stdin.close()
    process.stdout.close()


def write(place: Path, verb: str) -> None:
    if verb == "replace_folder":
        with replace_folder(place) as fresh:
            (fresh / "whole").touch()
    else:
        with replace_file(place) as fresh:
            fresh.write_text("whole")


@pytest.mark.parametrize("verb", ["replace_folder", "replace_file"])
def test_leftovers_of_a_killed_process_are_removed_and_those_of_a_running_one_kept(verb, tmp_path):
    killed, living = writing(tmp_path / "out", verb), writing(tmp_path / "out", verb)
    end(killed, signal.SIGKILL)
    mine = [tmp_path / ".out.needlefit-mine", tmp_path / ".out.abcdefgh", tmp_path / ".other.needlefit-a"]
    for folder in mine:  # none of which a process of needlefit has locked
        (folder / "notes").mkdir(parents=True)
    assert len(list(tmp_path.glob(".out.needlefit-*"))) == 3
    write(tmp_path / "out", verb)
    left = set(tmp_path.iterdir()) - {tmp_path / "out", *mine}
    assert len(left) == 1 and (left.pop() / "new").is_dir()
    assert all((folder / "notes").is_dir() for folder in mine)
    end(living, signal.SIGKILL)
    write(tmp_path / "out", verb)
    assert set(tmp_path.iterdir()) == {tmp_path / "out", *mine}


def test_the_only_copy_is_restored(tmp_path):
    """Killed between two renamings: the earlier folder stands in the scratch folder alone."""
    process = writing(tmp_path / "out", "replace_folder")
    (scratch,) = tmp_path.iterdir()
    (scratch / "old").mkdir()
    (scratch / "old" / "notes.txt").write_text("mine")
    end(process, signal.SIGKILL)
    with pytest.raises(ConfigError, match=r"notes\.txt"), replace_folder(tmp_path / "out") as fresh:
        (fresh / "whole").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


def test_an_exchanged_result_with_foreign_files_is_never_removed(tmp_path):
    """Killed after the exchange, before anybody looked at what was replaced."""
    write(tmp_path / "out", "replace_folder")
    process = writing(tmp_path / "out", "replace_folder")
    (scratch,) = tmp_path.glob(".out.*")
    (scratch / "old").mkdir()
    (scratch / "old" / "notes.txt").write_text("mine")
    end(process, signal.SIGKILL)
    write(tmp_path / "out", "replace_folder")
    assert (scratch / "old" / "notes.txt").read_text() == "mine"
    (scratch / "old" / "notes.txt").unlink()
    write(tmp_path / "out", "replace_folder")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
