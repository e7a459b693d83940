"""Read a file in a child process of limited memory and time, and map the arrays that it returns.

Readers written in C and C++ may crash on a damaged file, or fill the memory with one made to do so. In a
child process that is an error which names the file. The child writes its arrays into an anonymous shared
file, which the parent maps: nothing is copied, and nothing is unpickled. What else it returns is JSON.

Linux limits memory and processor time; macOS limits the processor time, Windows the time alone.
"""

import errno
import json
import math
import mmap
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from threading import Event, Timer
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from needlefit import errors
from needlefit.errors import ConfigError, DataError, NeedlefitError
from needlefit.project.processes import end_with

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

MEMORY_VARIABLE = "NEEDLEFIT_READ_GIB"
"""Environment variable: the memory that one file may take, GiB, in place of the defaults."""

READER_BYTES = 512 * 2**20
"""Memory of a reader beside what the header promises: tables, a compressed block, one slice."""

READER_SECONDS = 8  # processor time of a reader beside what the size of the content warrants
WALL_SECONDS = 60
"""Time in which a reader must be done, beside four times its processor time: a disk may be slow."""

MAX_RESULT_JSON_BYTES = 16 * 2**20
MAX_AXES = 4
DTYPES = ("float32", "float64", "int64", "bool")

_ENVIRONMENT = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS": "1",
    "MALLOC_ARENA_MAX": "1",  # each thread's arena would reserve address space
    "ARROW_DEFAULT_MEMORY_POOL": "system",  # its own reserves a GiB
}
_CHILD = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from needlefit.project import sandbox; "
    "sandbox.serve(json.loads(sys.argv[2]))"
)
_DAMAGED = "the file may be damaged: copy it or export it again"
_FAULTS = {
    "no result": ("the process that read it ended without an answer", "", ""),
    "crashed": ("its reader crashed ({signal})", "", ""),
    "raised": ("cannot be read ({name})", "", ""),
    "killed": (
        "the process that read it was ended from outside, as the system does when memory runs out",
        "up to {memory} of free memory",
        "free memory, or run fewer at once with --jobs",
    ),
    "memory": (
        "its reader needs more memory than {memory}",
        "a file that takes no more memory than its header promises",
        f"{_DAMAGED}; if you trust it and have the memory, set {MEMORY_VARIABLE} to more GiB",
    ),
    "time": (
        "its reader was ended: {allowed.cpu_seconds} s of processor time, or {allowed.wall_seconds:g} s",
        "a file that is read in the time that its size warrants",
        "",
    ),
}
"""Of a reader that gave nothing: what, expected and how to fix it; empty: those of a damaged file."""
_WINDOWS = os.name == "nt"

Array = NDArray[Any]
Child = subprocess.Popen[bytes]


@dataclass(frozen=True)
class ReaderLimits:
    """What a reader may take."""

    # Memory beyond that of the empty reader, without the arrays that it returns
    memory_bytes: int = READER_BYTES
    result_bytes: int = READER_BYTES  # all arrays that it returns
    # `cpu_seconds`, `wall_seconds`: processor time and time
    cpu_seconds: int = READER_SECONDS
    wall_seconds: float = WALL_SECONDS + 4 * READER_SECONDS


def limits_for(native_bytes: int, result_bytes: int, cpu_seconds: float) -> ReaderLimits:
    """Return the limits of a reader that needs so much for the content of its file."""
    cpu = READER_SECONDS + math.ceil(cpu_seconds)
    return ReaderLimits(READER_BYTES + native_bytes, result_bytes, cpu, WALL_SECONDS + 4 * cpu)


def stated_memory_bytes() -> int | None:
    """Return the memory that the user grants one file; None if the environment variable is not set.

    ConfigError if it is not a number of GiB.
    """
    text = os.environ.get(MEMORY_VARIABLE, "")
    if not text:
        return None
    with suppress(ValueError, OverflowError):
        if (stated := int(float(text) * 2**30)) > 0:
            return stated
    raise ConfigError(
        f"is {text[:40]!r}",
        where=MEMORY_VARIABLE,
        expected="GiB, such as 16",
        fix="set a number, or unset it",
    )


def read_in_sandbox(
    reader: str, file: Path, allowed: ReaderLimits, arguments: Mapping[str, Any]
) -> tuple[Any, dict[str, Array]]:
    """Run a reader in a limited child process; return its value and its arrays.

    `reader` is "module:function". It is called with a `SandboxArrays`, which makes the arrays that it fills,
    and with the `arguments`; these and its value are JSON. Its module is imported before the limits are set.
    Messages name `file`.

    Raised is what the reader raised, a NeedlefitError; DataError if it crashed, or needed more memory or time
    than `allowed`; ModuleNotFoundError if the child lacks a package.
    """
    with _shared_file() as shared:
        request = {
            "reader": reader,
            "arguments": arguments,
            "limits": asdict(allowed),
            "parent": os.getpid(),
            "shared": shared.name if _WINDOWS else shared.fileno(),
        }
        answer = _parse_result(_run(request, file, shared, allowed), file, allowed)
        try:
            return answer["value"], _arrays(answer["arrays"], shared, allowed)
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError):
            raise _fault("no result", file, allowed) from None


def _fault(kind: str, file: Path, allowed: ReaderLimits, **words: object) -> DataError:
    memory = f"{(allowed.memory_bytes + allowed.result_bytes) / 2**30:.3g} GiB"
    what, expected, fix = (one.format(allowed=allowed, memory=memory, **words) for one in _FAULTS[kind])
    expected = expected or "a whole file, as its program wrote it"
    return DataError(what, where=str(file), expected=expected, fix=fix or _DAMAGED)


def _run(request: Mapping[str, Any], file: Path, shared: BinaryIO, allowed: ReaderLimits) -> bytes:
    """Return what the child answers; DataError if it was ended by a signal or by the time limit."""
    late = Event()

    def end() -> None:
        late.set()
        child.kill()

    with _start_child(request, file, shared) as child:
        timer = Timer(allowed.wall_seconds, end)
        timer.daemon = True
        timer.start()
        try:
            assert child.stdout is not None
            answer = child.stdout.read(MAX_RESULT_JSON_BYTES + 1)
            if len(answer) > MAX_RESULT_JSON_BYTES:
                raise _fault("no result", file, allowed)
            child.wait()
        except BaseException:  # Ctrl-C among them
            child.kill()
            raise
        finally:
            timer.cancel()
    if late.is_set() or child.returncode == -getattr(signal, "SIGXCPU", 0):
        raise _fault("time", file, allowed)
    if child.returncode == -getattr(signal, "SIGKILL", 0):
        raise _fault("killed", file, allowed)
    if child.returncode:
        with suppress(ValueError):
            raise _fault("crashed", file, allowed, signal=signal.Signals(-child.returncode).name)
        raise _fault("no result", file, allowed)
    return answer


def _start_child(request: Mapping[str, Any], file: Path, shared: BinaryIO) -> Child:
    python = (sys.executable, "-I", "-X", f"utf8={sys.flags.utf8_mode}", "-c", _CHILD)
    here = str(Path(errors.__file__).parents[1])
    # the child finds modules where this process does, but not in the working folder
    search_path = json.dumps([here] * (here not in sys.path) + [entry for entry in sys.path if entry])
    try:
        return subprocess.Popen(
            [*python, search_path, json.dumps(request)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_ENVIRONMENT},
            pass_fds=() if _WINDOWS else (shared.fileno(),),
            start_new_session=True,  # Ctrl-C is for the parent, which ends the child
        )
    except OSError as fault:
        raise ConfigError(
            f"no process can be started to read it: {fault.strerror}",
            where=str(file),
            expected="a system that starts one more process of Python",
            fix="free memory, or run fewer at once with --jobs",
        ) from None


@contextmanager
def _shared_file() -> Iterator[BinaryIO]:
    """Yield a file that the child fills: in memory on Linux, without a name elsewhere."""
    if hasattr(os, "memfd_create"):
        with os.fdopen(os.memfd_create("needlefit"), "r+b", buffering=0) as file:
            yield file
    elif _WINDOWS:  # it passes no descriptors, and removes no file that is mapped
        descriptor, name = tempfile.mkstemp()
        os.close(descriptor)
        try:
            with Path(name).open("r+b", buffering=0) as file:
                yield file
        finally:
            Path(name).unlink()
    else:
        with tempfile.TemporaryFile(buffering=0) as file:
            yield file


def _arrays(described: Mapping[str, Any], shared: BinaryIO, allowed: ReaderLimits) -> dict[str, Array]:
    """Map the arrays of an answer; ValueError or TypeError if they are not as `SandboxArrays` makes them."""
    size = os.fstat(shared.fileno()).st_size
    if size > allowed.result_bytes + len(described) * mmap.ALLOCATIONGRANULARITY:
        raise ValueError("more was written than was allowed")
    mapped = mmap.mmap(shared.fileno(), size) if size else mmap.mmap(-1, 1)  # of empty arrays alone
    found = {str(name): _array(mapped, *parts) for name, parts in described.items()}
    return {name: array.copy() for name, array in found.items()} if _WINDOWS else found


def _array(mapped: mmap.mmap, dtype: str, shape: list[int], offset: int) -> Array:
    if dtype not in DTYPES or not 0 < len(shape) <= MAX_AXES:
        raise ValueError("no array")
    if not all(type(n) is int and n >= 0 for n in [*shape, offset]) or offset % mmap.ALLOCATIONGRANULARITY:
        raise ValueError("no array")
    count = math.prod(shape)
    if not count:
        return np.empty(shape, dtype)
    return np.frombuffer(mapped, dtype, count, offset).reshape(shape)  # ValueError beyond its end


def _parse_result(text: bytes, file: Path, allowed: ReaderLimits) -> dict[str, Any]:
    """Return the answer of a reader that succeeded; else raise what it says."""
    error: Exception
    try:
        answer: dict[str, Any] = json.loads(text)
        kind = answer["kind"]
        if kind == "value":
            return answer
        if kind == "missing":
            name = str(answer["name"])
            error = ModuleNotFoundError(f"No module named {name!r}", name=name)
        elif kind in ("memory", "raised"):
            error = _fault(kind, file, allowed, name=answer.get("name"))
        else:
            where, expected, fix = (str(answer[key]) for key in ("where", "expected", "fix"))
            raised = ConfigError if kind == "ConfigError" else DataError
            error = raised(str(answer["what"]), where=where, expected=expected, fix=fix)
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        error = _fault("no result", file, allowed)
    raise error from None


class SandboxArrays:
    """In the child: the arrays that a reader returns, in the file that it shares with its parent."""

    def __init__(self, shared: int, allowed: ReaderLimits) -> None:
        self.described: dict[str, tuple[str, tuple[int, ...], int]] = {}
        self._shared, self._allowed = shared, allowed
        self._end, self._taken = 0, 0

    def new(self, name: str, shape: tuple[int, ...], dtype: str) -> Array:
        """Return a new array of zeros, of one of `DTYPES`, to be filled.

        MemoryError if all arrays together exceed their limit.
        """
        size = math.prod(shape) * np.dtype(dtype).itemsize
        self._taken += size
        if self._taken > self._allowed.result_bytes:
            raise MemoryError
        offset, self.described[name] = self._end, (dtype, shape, self._end)
        if not size:
            return np.empty(shape, dtype)
        self._end += -(-size // mmap.ALLOCATIONGRANULARITY) * mmap.ALLOCATIONGRANULARITY
        os.ftruncate(self._shared, offset + size)
        allow_memory(self._end - offset)
        mapped = mmap.mmap(self._shared, size, offset=offset)
        return np.frombuffer(mapped, dtype).reshape(shape)


def allow_memory(size: int) -> None:
    """In the child: grant the reader so many more bytes, once the header that promises them is checked."""
    if resource is None:
        return
    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    if soft != resource.RLIM_INFINITY:
        _limit(resource.RLIMIT_AS, soft + size)


def serve(request: dict[str, Any]) -> None:
    """In the child: run the reader of a request under its limits, answer, and end."""
    end_with(request["parent"])
    pipe = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # a native library may write there
    text = json.dumps(_attempt(request)).encode("ascii")
    with os.fdopen(pipe, "wb") as answers:
        answers.write(text)
    os._exit(0)  # what native libraries do at the end takes time, and may crash


def _attempt(request: dict[str, Any]) -> dict[str, Any]:
    try:
        module, _, name = request["reader"].partition(":")
        reader = getattr(import_module(module), name)
        allowed = ReaderLimits(**request["limits"])
        shared = request["shared"]
        results = SandboxArrays(os.open(shared, os.O_RDWR) if isinstance(shared, str) else shared, allowed)
        _set_limits(allowed)
        value = reader(results, **request["arguments"])
        return {"kind": "value", "value": value, "arrays": results.described}
    except NeedlefitError as error:
        parts = {key: getattr(error, key) for key in ("what", "where", "expected", "fix")}
        return {"kind": type(error).__name__, **parts}
    except ModuleNotFoundError as error:
        return {"kind": "missing", "name": error.name}
    except MemoryError:
        return {"kind": "memory"}
    except Exception as error:  # whatever the bytes provoke; its text may quote them
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            return {"kind": "memory"}
        return {"kind": "raised", "name": type(error).__name__}


def _set_limits(allowed: ReaderLimits) -> None:
    if resource is None:
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    _limit(resource.RLIMIT_CPU, math.ceil(used.ru_utime + used.ru_stime) + allowed.cpu_seconds)
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_FSIZE, allowed.result_bytes + READER_BYTES)
    pages = Path("/proc/self/statm")
    if pages.exists():  # elsewhere address space cannot be measured
        taken = int(pages.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
        _limit(resource.RLIMIT_AS, taken + allowed.memory_bytes)


def _limit(kind: int, wanted: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard))
