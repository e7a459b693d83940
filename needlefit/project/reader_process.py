"""Read a file of another program in a child process of limited memory and time.

Readers written in C and C++ may crash on a damaged file, or fill the memory with one made to do so. In a
child process that is an error which names the file. The child answers with a line of JSON and arrays in
numpy's format: nothing is unpickled.

Linux limits memory and processor time; macOS limits the processor time, Windows the time alone.
"""

import errno
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit import errors
from needlefit.errors import ConfigError, DataError, NeedlefitError
from needlefit.project.processes import THREAD_VARIABLES, end_with

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

MEMORY_VARIABLE = "NEEDLEFIT_READ_GIB"
"""Environment variable: the memory that one file may take, GiB, in place of the defaults."""

READER_BYTES = 512 * 2**20
"""Memory of a reader beside what the content of its file warrants: tables, a compressed block, one slice."""

READER_SECONDS = 8  # processor time of a reader beside what the size of the content warrants
WALL_SECONDS = 60  # time in which a reader must be done, beside four times its processor time
MAX_ANSWER_BYTES = 16 * 2**20  # size of the JSON

_CHILD = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from needlefit.project import reader_process; "
    "reader_process.serve(json.loads(sys.argv[2]))"
)
_ENVIRONMENT = {
    **dict.fromkeys((*THREAD_VARIABLES, "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS"), "1"),
    "MALLOC_ARENA_MAX": "1",  # each thread's arena would reserve address space
}
_WHOLE = "a whole file, as its program wrote it"
_DAMAGED = "the file may be damaged: copy it or export it again"

Arrays = dict[str, NDArray[Any]]


def stated_memory_bytes() -> int | None:
    """Return the memory that the user grants one file; None if the environment variable is not set.

    ConfigError if it is not a number of GiB.
    """
    text = os.environ.get(MEMORY_VARIABLE, "")
    try:
        stated = int(float(text or 1) * 2**30)
    except (ValueError, OverflowError):
        stated = 0
    if stated <= 0:
        what, fix = f"is {text[:40]!r}", "set a number, or unset it"
        raise ConfigError(what, where=MEMORY_VARIABLE, expected="GiB, such as 16", fix=fix)
    return stated if text else None


def read_in_process(
    reader: str, file: Path, arguments: Mapping[str, Any], memory_bytes: int = 0, seconds: float = 0.0
) -> tuple[Any, Arrays]:
    """Run a reader in a limited child process; return its value and its arrays.

    `reader` is "module:function". It is called with a dictionary, to which it adds arrays, and with the
    `arguments`; these and its value are JSON. Its module is imported before the limits are set: memory of
    `READER_BYTES` and `memory_bytes`, processor time of `READER_SECONDS` and `seconds`. Messages name `file`.

    DataError if the reader refused the file, crashed, or needed more memory or time.
    """
    request = {
        **{"reader": reader, "arguments": arguments, "file": str(file), "parent": os.getpid()},
        **{"memory": READER_BYTES + memory_bytes, "seconds": READER_SECONDS + math.ceil(seconds)},
    }
    answer, arrays = _run(request, file)
    if "error" in answer:
        raise DataError(**answer["error"])
    return answer["value"], arrays


def _run(request: Mapping[str, Any], file: Path) -> tuple[dict[str, Any], Arrays]:
    """Return what the child answers, and its arrays; DataError if it ended without an answer."""
    here, most = str(Path(errors.__file__).parents[1]), WALL_SECONDS + 4 * request["seconds"]
    # the child finds modules where this process does, but not in the working folder
    search_path = [here] * (here not in sys.path) + [entry for entry in sys.path if entry]
    python = [sys.executable, "-I", "-X", f"utf8={sys.flags.utf8_mode}", "-c", _CHILD]
    with tempfile.TemporaryFile(buffering=0) as written:
        ending = "ended without an answer"
        try:
            code = subprocess.run(
                [*python, json.dumps(search_path), json.dumps(request)],
                stdin=subprocess.DEVNULL,
                stdout=written,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **_ENVIRONMENT},
                timeout=most,
                check=False,
                start_new_session=True,  # Ctrl-C is for the parent, which ends the child
            ).returncode
            ending = f"crashed ({signal.Signals(-code).name})" if code < 0 else ending
            written.seek(0)
            with os.fdopen(written.fileno(), "rb", closefd=False) as stored:
                answer = json.loads(stored.readline(MAX_ANSWER_BYTES))
                return answer, {name: np.load(stored, allow_pickle=False) for name in answer["arrays"]}
        except subprocess.TimeoutExpired:
            ending = "crashed (SIGXCPU)"
        except (KeyError, TypeError, ValueError, EOFError):
            pass
    more = {
        "crashed (SIGXCPU)": f"was ended: {request['seconds']} s of processor time, or {most:g} s",
        "crashed (SIGKILL)": "was ended from outside, as the system does when memory runs out",
    }
    raise DataError(f"its reader {more.get(ending, ending)}", where=str(file), expected=_WHOLE, fix=_DAMAGED)


# ---- in the child


def serve(request: Mapping[str, Any]) -> None:
    """Run the reader of a request under its limits, answer, and end."""
    end_with(request["parent"])
    arrays: Arrays = {}
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # a native library may write there
        answer = {**_attempt(request, arrays), "arrays": list(arrays)}
        answers.write(json.dumps(answer).encode("ascii") + b"\n")
        for array in arrays.values():
            np.save(answers, array, allow_pickle=False)
    os._exit(0)  # what native libraries do at the end takes time, and may crash


def _attempt(request: Mapping[str, Any], arrays: Arrays) -> dict[str, Any]:
    parts = {"where": request["file"], "expected": _WHOLE, "fix": _DAMAGED}
    try:
        module, _, name = request["reader"].partition(":")
        reader = getattr(import_module(module), name)
        if resource is not None:
            _set_limits(request["memory"], request["seconds"])
        return {"value": reader(arrays, **request["arguments"])}
    except NeedlefitError as error:
        parts = {key: getattr(error, key) for key in ("what", "where", "expected", "fix")}
    except Exception as error:  # whatever the bytes provoke; its text may quote them
        parts["what"] = f"cannot be read ({type(error).__name__})"
        if isinstance(error, MemoryError) or getattr(error, "errno", 0) == errno.ENOMEM:
            parts["what"] = f"its reader needs more memory than {request['memory'] / 2**30:.3g} GiB"
            parts["fix"] += f"; if you trust it and have the memory, set {MEMORY_VARIABLE} to more GiB"
    arrays.clear()
    return {"error": parts}


def _set_limits(memory: int, seconds: int) -> None:
    used = resource.getrusage(resource.RUSAGE_SELF)
    _limit(resource.RLIMIT_CPU, math.ceil(used.ru_utime + used.ru_stime) + seconds)
    _limit(resource.RLIMIT_CORE, 0)
    pages = Path("/proc/self/statm")
    if pages.exists():  # elsewhere address space cannot be measured
        taken = int(pages.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
        _limit(resource.RLIMIT_AS, taken + memory)


def allow_memory(size: int) -> None:
    """Grant the reader so many more bytes, once the header that promises them is checked."""
    if resource is not None and (soft := resource.getrlimit(resource.RLIMIT_AS)[0]) >= 0:  # -1: no limit
        _limit(resource.RLIMIT_AS, soft + size)


def _limit(kind: int, wanted: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))
