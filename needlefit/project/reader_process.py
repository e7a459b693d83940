"""Read a file of another program in a child process of limited memory and time.

Readers in C and C++ may crash on a damaged file, or fill the memory. In a child process that is an error that
names the file. The child answers with a line of JSON and arrays in numpy's format: nothing is unpickled.
Linux limits memory and processor time, macOS the processor time, Windows the time alone.
"""

import errno
import json
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from needlefit import errors
from needlefit.errors import ConfigError, DataError, NeedlefitError
from needlefit.project.processes import THREAD_VARIABLES, end_with

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

# environment variable: the largest memory (GiB) that reading one file may take
MEMORY_VARIABLE = "NEEDLEFIT_READ_GIB"
# largest memory of a reader (bytes), besides what the content of its file warrants
READER_BYTES = 512 * 2**20
# size (bytes) of a file of tables or points that warrants one second of processor time
BYTES_PER_SECOND = 2**20
READER_SECONDS = 8  # largest processor time of a reader (s), besides what the size of the content warrants
WALL_SECONDS = 60  # longest time (s) that a reader may take, besides four times its processor time
MAX_ANSWER_BYTES = 16 * 2**20  # largest size of a reader's answer, as JSON (bytes)

# environment variables that are all 1
_ONE_THREAD = (*THREAD_VARIABLES, "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS", "MALLOC_ARENA_MAX")

Arrays = dict[str, NDArray[Any]]


class Planes(np.ndarray[Any, Any]):
    """An array (K, ...) that is written in single precision, plane by plane: a copy of it takes memory."""


def stated_memory_bytes() -> int | None:
    """Return the memory that the user grants one file; None if the environment variable is not set.

    ConfigError if it is not a number of GiB.
    """
    text = os.environ.get(MEMORY_VARIABLE, "")
    if text and not re.fullmatch(r"(?!0*\.?0*$)\d{1,6}(\.\d*)?", text):  # a number above 0
        raise ConfigError(
            f"is {text[:40]!r}",
            expected="GiB, such as 16",
            fix="set a number, or unset it",
            where=MEMORY_VARIABLE,
        )
    return int(float(text) * 2**30) if text else None


def read_in_process(
    reader: str, file: Path, arguments: Mapping[str, Any], memory_bytes: int = 0, seconds: float = 0.0
) -> tuple[Any, Arrays]:
    """Run a reader in a limited child process; return its value and its arrays.

    `reader` is "module:function". It is called with a dictionary, to which it adds arrays, and with the
    `arguments`; these and its value are JSON. Its module is imported before the limits are set: memory of
    `READER_BYTES` and `memory_bytes`, processor time of `READER_SECONDS` and `seconds`. Messages name `file`.

    DataError if the reader refused the file, crashed, or needed more memory or time.
    """
    limits = {"memory": READER_BYTES + memory_bytes, "seconds": READER_SECONDS + math.ceil(seconds)}
    request = {"reader": reader, "arguments": arguments, "file": str(file), "parent": os.getpid(), **limits}
    here, most = str(Path(errors.__file__).parents[1]), WALL_SECONDS + 4 * limits["seconds"]
    # the child finds modules where this process does, but not in the working folder
    search_path = [here] * (here not in sys.path) + [entry for entry in sys.path if entry]
    child = f"import json, sys; sys.path[:], r = json.loads(sys.argv[1]); import {__name__} as m; m.serve(r)"
    python = [sys.executable, "-I", "-X", f"utf8={sys.flags.utf8_mode}", "-c", child]
    with tempfile.TemporaryFile(buffering=0) as written:
        try:
            code = subprocess.run(
                [*python, json.dumps([search_path, request])],
                stdin=subprocess.DEVNULL,
                stdout=written,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **dict.fromkeys(_ONE_THREAD, "1")},
                timeout=most,
                check=False,
                start_new_session=True,  # Ctrl-C is for the parent, which ends the child
            ).returncode
            error = {"what": f"its reader ended (exit code {code}): it crashed, or memory or time ran out"}
            written.seek(0)
            with os.fdopen(written.fileno(), "rb", closefd=False) as stored:
                answer = json.loads(stored.readline(MAX_ANSWER_BYTES))
                if "error" not in answer:
                    arrays = {name: np.load(stored, allow_pickle=False) for name in answer["arrays"]}
                    return answer["value"], arrays
                error = answer["error"]
        except subprocess.TimeoutExpired:
            error = {"what": f"its reader took more than {most:g} s"}
        except (KeyError, TypeError, ValueError, EOFError):
            pass  # it has not answered, or not to the end
    whole = {"expected": "a whole file, as its program wrote it", "fix": "copy it, or export it again"}
    raise DataError(**{"where": str(file)} | whole | error)


def serve(request: Mapping[str, Any]) -> None:
    """In the child: run the reader of a request under its limits, answer, and end."""
    end_with(request["parent"])
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # a native library may write there
        write_answer(request, answers)
    os._exit(0)  # what native libraries do at the end takes time, and may crash


def write_answer(request: Mapping[str, Any], answers: IO[bytes]) -> None:
    """Write the value of a request's reader and its arrays, or its error."""
    arrays: Arrays = {}
    try:
        module, _, name = request["reader"].partition(":")
        reader = getattr(import_module(module), name)
        if resource is not None:
            _set_limits(request["memory"], request["seconds"])
        answer = {"value": reader(arrays, **request["arguments"]), "arrays": list(arrays)}
    except NeedlefitError as error:
        answer = {"error": vars(error)}
    except BaseException as error:  # whatever the bytes provoke; its text may quote them
        parts = {"what": f"cannot be read ({type(error).__name__})"}
        if isinstance(error, MemoryError) or getattr(error, "errno", 0) == errno.ENOMEM:
            parts["what"] = f"its reader needs more memory than {request['memory'] / 2**30:.3g} GiB"
            parts["fix"] = f"if you trust the file, set {MEMORY_VARIABLE} to more GiB"
        answer = {"error": parts}
    answers.write(json.dumps(answer).encode("ascii") + b"\n")
    for array in arrays.values() if "value" in answer else ():
        if isinstance(array, Planes):
            header = {"descr": "<f4", "fortran_order": False, "shape": array.shape}
            np.lib.format.write_array_header_1_0(answers, header)
            for plane in array:
                answers.write(plane.astype("<f4").tobytes())
        else:
            np.save(answers, array, allow_pickle=False)


def _set_limits(memory: int, seconds: int) -> None:
    _limit(resource.RLIMIT_CPU, math.ceil(sum(os.times()[:2])) + seconds)  # beside what it has taken
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
