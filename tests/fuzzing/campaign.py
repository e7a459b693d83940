"""Many mutants of a reader, read in a process that may crash, hang or grow; each gets a verdict."""

import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from fuzzing.worker import CASE, MAX_MIB, MAX_SECONDS

TESTS = Path(__file__).resolve().parents[1]

PATIENCE_S = 60.0
"""Wall time after which a reader hangs, on a machine that others use too."""

START_S = 300.0
"""Wall time to import the readers and build valid inputs."""

LOOK_S = 0.5


@dataclass(frozen=True)
class Verdict:
    """What came of one mutant; `detail` is the error's text, or what is wrong with it."""

    reader: str
    number: int
    outcome: Literal["accepted", "refused", "violation"]
    detail: str = ""
    seconds: float = 0.0
    mib: float = 0.0


class Workers:
    """A process that reads mutants; another one takes its place when it ends.

    Use it as a context: its folder goes with it. A reader that takes more than `max_seconds` of processor
    time is ended.
    """

    def __init__(self, max_seconds: float = MAX_SECONDS) -> None:
        self.max_seconds = max_seconds
        self.folder = Path(tempfile.mkdtemp(prefix="needlefit-fuzz-"))
        self._process: subprocess.Popen[str] | None = None
        self._answers = -1
        self._ready: set[str] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        shutil.rmtree(self.folder, ignore_errors=True)

    def verdicts(
        self, reader: str, numbers: Iterable[int], seed: int = 1, keep: Path | None = None
    ) -> Iterator[Verdict]:
        """Yield the verdict on each mutant; inputs of violations are copied to `keep`."""
        for number in numbers:
            verdict = self._verdict(reader, number, seed)
            if verdict.outcome == "violation" and keep is not None:
                _copy(self.folder / CASE, keep / f"{reader}-{seed}-{number}", verdict)
            yield verdict

    def inputs(self, reader: str) -> int:
        """Return how many valid inputs a reader has: the first mutants are these, undamaged."""
        process = self._process or self._begin()
        _ask(process, reader, None, 0)
        answer, why = self._wait(process, START_S, START_S)
        if answer is None:
            raise RuntimeError(f"the valid inputs of {reader} cannot be built: {why}")
        self._ready.add(reader)
        return int(answer["inputs"])

    def _verdict(self, reader: str, number: int, seed: int) -> Verdict:
        if self._process is None or reader not in self._ready:
            self.inputs(reader)
        assert self._process is not None
        _ask(self._process, reader, number, seed)
        answer, why = self._wait(self._process, self.max_seconds, PATIENCE_S)
        if answer is None:
            return Verdict(reader, number, "violation", why)
        if answer["mib"] > MAX_MIB or answer["seconds"] > MAX_SECONDS:
            self._end()  # what it holds, or its children's peak of memory, must not count again
        return Verdict(reader, number, answer["outcome"], answer["detail"], answer["seconds"], answer["mib"])

    def _wait(
        self, process: "subprocess.Popen[str]", processor_s: float, wall_s: float
    ) -> tuple[dict | None, str]:
        """Return the answer, or None and how the process ended."""
        began, used, text = time.monotonic(), _processor_seconds(process.pid), b""
        while not text.endswith(b"\n"):
            if select.select([self._answers], [], [], LOOK_S)[0]:
                part = os.read(self._answers, 65536)
                if not part:
                    code = process.wait()
                    self._end()
                    return None, f"the process ended with {code}"
                text += part
                continue
            waited, took = time.monotonic() - began, _processor_seconds(process.pid) - used
            if took > processor_s or waited > wall_s:
                self._end()
                return None, f"did not end within {took:.0f} s of processor time, {waited:.0f} s in all"
        return json.loads(text), ""

    def _begin(self) -> "subprocess.Popen[str]":
        self._answers, theirs = os.pipe()
        path = os.pathsep.join([str(TESTS), str(TESTS.parent), os.environ.get("PYTHONPATH", "")])
        (self.folder / "home").mkdir(exist_ok=True)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "fuzzing.worker", str(self.folder), str(theirs)],
            stdin=subprocess.PIPE,
            cwd=self.folder / "home",
            env=os.environ | {"PYTHONPATH": path, "PYTHONHASHSEED": "0"},
            pass_fds=(theirs,),
            text=True,
            start_new_session=True,
        )
        os.close(theirs)
        return self._process

    def _end(self) -> None:
        if self._process is None:
            return
        self._process.kill()
        self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()
        os.close(self._answers)
        self._process = None
        self._ready = set()


def _ask(process: "subprocess.Popen[str]", reader: str, number: int | None, seed: int) -> None:
    assert process.stdin is not None
    process.stdin.write(json.dumps({"reader": reader, "number": number, "seed": seed}) + "\n")
    process.stdin.flush()


def _processor_seconds(process: int) -> float:
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _copy(case: Path, kept: Path, verdict: Verdict) -> None:
    shutil.rmtree(kept, ignore_errors=True)
    kept.mkdir(parents=True)
    if case.is_dir():  # the process may have ended before it had written the mutant
        shutil.copytree(case, kept, dirs_exist_ok=True)
    (kept / "VERDICT.txt").write_text(f"{verdict}\n", encoding="utf-8", errors="backslashreplace")
