"""The tiny world: three insertions into two layers, and one finished run of every kind of study.

Its project lies in `tiny_world/`; its data are simulated. A run is made by its command when a test first
asks for it, and kept for all processes of the session: the tests of reports, differences, Python, viewer and
command line read the same runs.
"""

import io
import json
import shutil
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import needles
import pytest
import track_cases

from needlefit.cli import main
from needlefit.studies.run import restore_run

try:
    import fcntl
except ImportError:  # Windows: there the tests of one session are to run in one process
    fcntl = None  # type: ignore[assignment]

PROJECT = Path(__file__).parent / "tiny_world"
SHORT = (0, 5)
"""Exit codes of a run too short to converge in every respect."""


@dataclass(frozen=True)
class Command:
    """What runs a study of a kind, the folder of its result, and the exit codes that it may end with.

    `after`: the kinds of which it reads a run.
    """

    words: tuple[str, ...]
    folder: str
    codes: tuple[int, ...] = SHORT
    after: tuple[str, ...] = ()
    kind: str = ""  #: of study, where it is not the command's name


def _validate(name, *codes):
    return Command(("validate", name), name, codes or SHORT)


COMMANDS = MappingProxyType(
    {
        "cross_validation": _validate("held_out", 0),
        "fit": Command(("tune", "gel"), "gel", (0, 5)),
        "identification": Command(("tune", "gel", "--design"), "gel-design", (0,)),
        "prediction": Command(
            ("predict", "held_out", "--scene", "ahead"),
            "predict-held_out-ahead",
            SHORT,
            ("cross_validation",),
        ),
        "reconstruction": Command(("reconstruct", "sample_scan"), "scanned", (0,)),
        "tracks": replace(_validate("tracks"), kind="cross_validation"),
    }
)
"""By kind of study, and of tip tracks, which are cross-validated."""


def find_words(kind, reports, jobs=1):
    """Return the command of a kind that leaves its result in a folder of `reports`."""
    command = COMMANDS[kind]
    out = reports / command.folder if kind == "reconstruction" else reports  # which names its own folder
    return [*command.words, "--out", str(out), "--jobs", str(jobs)]


def build_project(folder):
    """Write the project and its data to a folder that is not there yet."""
    shutil.copytree(PROJECT, folder)
    needles.build(folder / "data/needles", needles.DEPTHS[:3])
    rest = [
        track_cases.measured(track_cases.track(f"rest{n}", 0 * track_cases.GUIDE), n, 0.03, n)
        for n in range(4)
    ]
    moved = track_cases.measured(track_cases.track("moved", track_cases.GUIDE), -1, 0.034, 9)
    track_cases.written(folder / "data/tips", [*rest, moved])


def copy_project(world, folder, *kinds):
    """Copy the project, and the finished runs of some kinds, into a folder; return it."""
    for kind in kinds:
        result = world.find(kind)
        shutil.copytree(result, folder / "reports" / result.name)
    for part in ("configs", "data", "studies"):
        shutil.copytree(world.folder / part, folder / part)
    return folder


@dataclass(frozen=True)
class World:
    """The project and its runs, for all processes of a session."""

    folder: Path

    def find(self, kind):
        """Return the folder of the finished run of a kind, which is made if it is not there."""
        command = COMMANDS[kind]
        for other in command.after:
            self.find(other)
        with _one_process(self.folder.parent / f"{kind}.lock"):
            if not self._outcome(kind).exists():
                self._run(kind, command)
        outcome = json.loads(self._outcome(kind).read_text(encoding="utf-8"))
        assert outcome["code"] in command.codes, outcome["printed"]
        return self._result(command)

    def restore(self, kind):
        """Return the run of a kind as it was stored."""
        return restore_run(self.find(kind))

    def _result(self, command):
        return self.folder / "reports" / command.folder

    def _outcome(self, kind):
        return self.folder.parent / f"{kind}.json"

    def _run(self, kind, command):
        printed = io.StringIO()
        with (
            chdir(self.folder),
            redirect_stdout(printed),
            redirect_stderr(printed),
            pytest.raises(SystemExit) as leaving,
        ):
            main(find_words(kind, self.folder / "reports"))
        outcome = {"code": int(leaving.value.code or 0), "printed": printed.getvalue()}
        self._outcome(kind).write_text(json.dumps(outcome), encoding="utf-8")


@contextmanager
def _one_process(lock):
    """Let one process at a time do what follows."""
    with lock.open("w") as file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def open_world(factory):
    """Return the world of this session; the process that comes first builds its project."""
    base = factory.getbasetemp()
    shared = base.parent if base.name.startswith("popen-") else base  # the processes of xdist
    place = shared / "world"
    place.mkdir(exist_ok=True)
    with _one_process(place / "project.lock"):
        if not (place / "project").exists():
            build_project(place / "project.partial")
            (place / "project.partial").rename(place / "project")
    return World(place / "project")
