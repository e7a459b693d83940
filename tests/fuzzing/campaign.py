"""Many mutants of a reader, read in a process that may crash, hang or grow; each gets a verdict."""

import os
import shutil
import tempfile
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import patch

from fuzzing.worker import CASE, MAX_MIB, MAX_SECONDS, Verdict, begin_process, count_inputs, read_mutant


class Workers:
    """A process that reads mutants; another one takes its place when it ends.

    Use it as a context: its folder goes with it. A reader that takes more than `MAX_SECONDS` of processor
    time is ended.
    """

    def __init__(self):
        self.folder = Path(tempfile.mkdtemp(prefix="needlefit-fuzz-"))
        self._pool = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._end()
        shutil.rmtree(self.folder, ignore_errors=True)

    def verdicts(self, reader, numbers, seed=1, keep=None):
        """Yield the verdict on each mutant; inputs of violations are copied to `keep`."""
        self.inputs(reader)
        for number in numbers:
            try:
                verdict = self._ask(read_mutant, reader, number, seed)
            except BrokenProcessPool:
                self._end()
                verdict = Verdict(reader, number, "violation", "the process crashed, or was ended as it hung")
            if verdict.mib > MAX_MIB or verdict.seconds > MAX_SECONDS:
                self._end()  # what it holds, or its children's peak of memory, must not count again
            if verdict.outcome == "violation" and keep is not None:
                _copy(self.folder / CASE, keep / f"{reader}-{seed}-{number}", verdict)
            yield verdict

    def inputs(self, reader):
        """Return how many valid inputs a reader has: the first mutants are these, undamaged."""
        return self._ask(count_inputs, reader)

    def _ask(self, function, *arguments):
        with patch.dict(os.environ, PYTHONHASHSEED="0"):  # of a process that begins now
            if self._pool is None:
                begin = (begin_process, (self.folder,))
                self._pool = ProcessPoolExecutor(1, get_context("spawn"), *begin)
            return self._pool.submit(function, self.folder, *arguments).result()

    def _end(self):
        if self._pool is not None:
            self._pool.shutdown()
        self._pool = None


def _copy(case, kept, verdict):
    shutil.rmtree(kept, ignore_errors=True)
    kept.mkdir(parents=True)
    if case.is_dir():  # the process may have ended before it had written the mutant
        shutil.copytree(case, kept, dirs_exist_ok=True)
    (kept / "VERDICT.txt").write_text(f"{verdict}\n", encoding="utf-8", errors="backslashreplace")
