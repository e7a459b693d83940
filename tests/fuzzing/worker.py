"""What a process does that reads mutants, one after the other, and returns what came of each.

Whatever a reader prints goes to a file. The process may end at any mutant, by a crash of native code or by a
limit: its input then lies in `FOLDER/case`.
"""

import os
import re
import resource
import shutil
import signal
import sys
import traceback
import warnings
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

CASE, PRINTED = "case", "printed"
WHO = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN

MAX_SECONDS, MAX_MIB = 10.0, 1024.0
"""What reading one file may take: processor time, and memory beyond what the process had before."""

PATIENCE_S = 600.0
"""Wall time after which a reader that takes no processor time waits for ever."""

MAX_MESSAGE = 20_000
"""Characters of an error: an input of any length makes no message of any length."""

ADDRESS_SPACE_MIB = 6 * 1024
"""What the process may map in all, so that a bomb ends in an error and not in a machine without memory."""

CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What a terminal acts on, or cannot print; line ends and tabs are none of it."""


def write_case(reader, number, seed, folder):
    """Write mutant `number` of a reader below `folder`; return what is to be opened.

    Number 0 to the count of valid inputs less 1 are these, undamaged.
    """
    from fuzzing.mutations import mutate
    from fuzzing.readers import READERS, inputs

    valid = inputs(reader, folder.parent / "inputs")
    shutil.rmtree(folder, ignore_errors=True)
    random = np.random.default_rng([seed, zlib.crc32(reader.encode()), number])
    one = valid[number] if number < len(valid) else valid[int(random.integers(len(valid)))]
    files = dict(one.files)
    if number >= len(valid):
        name = one.damaged[int(random.integers(len(one.damaged)))]
        others = [
            each.files[n] for each in valid for n in each.damaged if n.split(".")[1:] == name.split(".")[1:]
        ]
        files[name] = mutate(files[name], others, random, READERS[reader].packed)
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder / one.opened


@dataclass(frozen=True)
class Verdict:
    """What came of one mutant; `detail` is the error's text, or what is wrong with it."""

    reader: str
    number: int
    outcome: Literal["accepted", "refused", "violation"]
    detail: str = ""
    seconds: float = 0.0
    mib: float = 0.0


def begin_process(folder):
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_MIB * 2**20, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    (folder / "home").mkdir(exist_ok=True)
    os.chdir(folder / "home")
    out = os.open(folder / PRINTED, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    os.dup2(out, 1)
    os.dup2(out, 2)


def count_inputs(folder, reader):
    from fuzzing.readers import inputs

    return len(inputs(reader, folder / "inputs"))


def read_mutant(folder, reader, number, seed):
    """Read one mutant; the system ends the process at the limits of processor and wall time."""
    path = write_case(reader, number, seed, folder / CASE)
    unlimited = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (int(_seconds() + MAX_SECONDS) + 1, unlimited[1]))
    signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
    try:
        return _read(Verdict(reader, number, "accepted"), path, folder / PRINTED)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        resource.setrlimit(resource.RLIMIT_CPU, unlimited)


def _read(verdict, path, printed):
    from fuzzing.readers import READERS
    from needlefit.errors import NeedlefitError

    os.ftruncate(1, 0)
    began, before = _seconds(), _peak_memory()
    try:
        READERS[verdict.reader].read(path)
    except NeedlefitError as error:
        verdict = replace(verdict, outcome="refused", detail=str(error))
    except BaseException as error:  # a reader that raises SystemExit or KeyboardInterrupt is wrong as well
        what = f"{type(error).__name__} at {_place(error)}: {error}"[:400]
        verdict = replace(verdict, outcome="violation", detail=what)
    verdict = replace(verdict, seconds=_seconds() - began, mib=_peak_memory() - before)
    sys.stdout.flush()
    sys.stderr.flush()
    wrong = _find_wrong(verdict, printed.read_bytes().decode("utf-8", "replace"))
    return replace(verdict, outcome="violation", detail=wrong) if wrong else verdict


def _find_wrong(verdict, text):
    """Return what of a reading that took too much, or whose message a terminal would act on, is wrong."""
    if verdict.seconds > MAX_SECONDS or verdict.mib > MAX_MIB:
        return f"took {verdict.seconds:.1f} s of processor time and {verdict.mib:.0f} MiB"
    if verdict.outcome == "violation":
        return ""
    for where, shown in (("the message", verdict.detail), ("what it printed", text)):
        if CONTROL.search(shown):
            return f"control characters in {where}: {shown!r:.300}"
    if len(verdict.detail) > MAX_MESSAGE:
        return f"a message of {len(verdict.detail)} characters: {verdict.detail:.200}"
    return ""


def _place(error):
    """Return the last line of needlefit on the way to an error, and where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if f"{os.sep}needlefit{os.sep}" in frame.filename]
    last = (own or frames)[-1]
    return f"{Path(last.filename).name}:{last.lineno} {last.name}"


def _seconds():
    used = [resource.getrusage(who) for who in WHO]
    return sum(one.ru_utime + one.ru_stime for one in used)


def _peak_memory():
    """Return the peak of resident memory of this process, or of the largest waited for so far, MiB."""
    return max(resource.getrusage(who).ru_maxrss for who in WHO) / 1024
