"""A process that reads mutants, one after the other, and says what came of each.

It is asked on stdin, a line of JSON a mutant, and answers on the descriptor that it was given. Asked for no
number it builds the valid inputs, which may take a while. Whatever a reader prints goes to a file. The
process may end at any mutant, by a crash of native code: its input then lies in `FOLDER/case`.
"""

import json
import os
import re
import resource
import shutil
import sys
import traceback
import warnings
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

CASE = "case"

MAX_SECONDS, MAX_MIB = 10.0, 1024.0
"""What reading one file may take: processor time, and memory beyond what the process had before."""

MAX_MESSAGE = 20_000
"""Characters of an error: an input of any length makes no message of any length."""

ADDRESS_SPACE_MIB = 6 * 1024
"""What the process may map in all, so that a bomb ends in an error and not in a machine without memory."""

CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What a terminal acts on, or cannot print; line ends and tabs are none of it."""


def write_case(reader: str, number: int, seed: int, folder: Path) -> Path:
    """Write mutant `number` of a reader below `folder`; return what is to be opened.

    Number 0 to the count of valid inputs less 1 are these, undamaged.
    """
    from fuzzing.mutations import mutate
    from fuzzing.readers import inputs
    from fuzzing.readers import reader as find

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
        files[name] = mutate(files[name], others, random, find(reader).packed)
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder / one.opened


def read_case(reader: str, path: Path, printed: Path) -> dict[str, object]:
    """Read one input; return the outcome ("accepted", "refused", "violation"), why, seconds and MiB."""
    from fuzzing.readers import reader as find
    from needlefit.errors import NeedlefitError

    os.ftruncate(1, 0)
    began, before = _seconds(), _reset_memory()
    try:
        find(reader).read(path)
        outcome, detail = "accepted", ""
    except NeedlefitError as error:
        outcome, detail = "refused", str(error)
    except BaseException as error:  # a reader that raises SystemExit or KeyboardInterrupt is wrong as well
        outcome, detail = "violation", f"{type(error).__name__} at {_place(error)}: {error}"[:400]
    seconds, mib = _seconds() - began, _memory() - before
    sys.stdout.flush()
    sys.stderr.flush()
    used: dict[str, object] = {"seconds": seconds, "mib": mib}
    if seconds > MAX_SECONDS or mib > MAX_MIB:
        detail = f"took {seconds:.1f} s of processor time and {mib:.0f} MiB"
        return {"outcome": "violation", "detail": detail} | used
    return _judged(outcome, detail, printed.read_bytes().decode("utf-8", "replace")) | used


def _judged(outcome: str, detail: str, text: str) -> dict[str, object]:
    """Turn a refusal whose message, or anything printed, a terminal would act on, into a violation."""
    if outcome != "violation":
        if CONTROL.search(detail) or CONTROL.search(text):
            where = "the message" if CONTROL.search(detail) else "what it printed"
            return {
                "outcome": "violation",
                "detail": f"control characters in {where}: {detail or text!r:.300}",
            }
        if len(detail) > MAX_MESSAGE:
            return {"outcome": "violation", "detail": f"a message of {len(detail)} characters: {detail:.200}"}
    return {"outcome": outcome, "detail": detail}


def _place(error: BaseException) -> str:
    """Return the last line of needlefit on the way to an error, and where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if f"{os.sep}needlefit{os.sep}" in frame.filename]
    last = (own or frames)[-1]
    return f"{Path(last.filename).name}:{last.lineno} {last.name}"


def _seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def _reset_memory() -> float:
    """Set the peak of resident memory to what is held now; return it, MiB."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:  # no Linux: the peak of the whole process counts
        return 0.0
    return _own_peak()


def _memory() -> float:
    """Return the peak of resident memory since, or of the largest process waited for so far, MiB."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    return max(_own_peak(), children)


def _own_peak() -> float:
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return int(re.search(r"VmHWM:\s+(\d+)", status)[1]) / 1024


def _answer(asked: Mapping[str, object], folder: Path, printed: Path) -> dict[str, object]:
    from fuzzing.readers import inputs

    reader, number = str(asked["reader"]), asked["number"]
    if number is None:
        return {"inputs": len(inputs(reader, folder / "inputs"))}
    path = write_case(reader, int(number), int(asked["seed"]), folder / CASE)
    return read_case(reader, path, printed)


def main(folder: Path, descriptor: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_MIB * 2**20, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    printed = folder / "printed"
    out = os.open(printed, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    os.dup2(out, 1)
    os.dup2(out, 2)
    with os.fdopen(descriptor, "w", buffering=1) as answers:
        for line in sys.stdin:
            answers.write(json.dumps(_answer(json.loads(line), folder, printed)) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
