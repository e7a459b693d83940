"""Keep compiled functions on disk, in a folder that only this user can write to; each file is whole and
checked, or not used.

Compiled code is kept as pickles and machine code. Reading it runs it, so it must be as trusted as the program
itself: it is read only from a folder that belongs to this user and that nobody else can write to. Without
such a folder, the functions go to a temporary folder that is removed when the process ends.

Numba's own cache has an index file beside each data file, reads them as they come, and tells whether one is
stale by the file that the function stands in alone, not by the files that it calls. Here every compiled
function is one file that begins with the digest of the rest and is put in place whole; what is damaged, cut
off or cannot be written is compiled again. The folder is named after all sources of the kernel, the processor
and the versions of Python and numba, so that nothing stale is ever run, whichever file changed.
"""

import atexit
import hashlib
import os
import pickle
import shutil
import stat
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding
from numba import types
from numba.core.caching import FunctionCache
from numba.core.serialize import dumps

CACHE_DIR_VARIABLE = "NEEDLEFIT_CACHE_DIR"
"""Environment variable: where to keep compiled functions. A temporary folder is handed to children by it."""

DIGEST_BYTES = hashlib.sha256().digest_size


@dataclass(frozen=True)
class CacheFolder:
    """The folder of compiled functions; `why_temporary` is empty if they are kept after the process ends."""

    path: Path
    why_temporary: str = ""


@cache
def find_cache_folder() -> CacheFolder:
    """Return the folder of the compiled functions of exactly these sources, on this processor."""
    path = _find_cache_root() / _hash_sources()
    why = _find_problem(path)
    if not why:
        return CacheFolder(path)
    temporary = Path(tempfile.mkdtemp(prefix="needlefit-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    os.environ[CACHE_DIR_VARIABLE] = str(temporary)  # a process that this one starts need not compile again
    (temporary / path.name).mkdir(mode=0o700)
    return CacheFolder(temporary / path.name, f"{path} {why}")


def _find_cache_root() -> Path:
    configured = os.environ.get(CACHE_DIR_VARIABLE) or os.environ.get("NUMBA_CACHE_DIR")
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # a relative one is invalid by its specification, and ignored
    default = (base if base.is_absolute() else Path("~/.cache")) / "needlefit"
    path = Path(configured) if configured else default
    try:
        return path.expanduser()
    except RuntimeError:
        return path  # there is no such home folder: `_find_problem` refuses it


def _hash_sources() -> str:
    here = Path(__file__).parent
    sources = b"".join(path.name.encode() + path.read_bytes() for path in sorted(here.rglob("*.py")))
    features = binding.get_host_cpu_features().flatten()
    config: Any = numba.config  # a module that makes its attributes at run time
    target = (binding.get_host_cpu_name(), features, config.CPU_NAME, config.CPU_FEATURES, config.OPT)
    versions = (numba.__version__, sys.implementation.cache_tag)
    return hashlib.sha256(sources + repr((target, versions)).encode()).hexdigest()[:16]


def _find_problem(path: Path) -> str:
    """Return why compiled functions cannot be kept in `path`; make it if it is missing."""
    if path.parts[0].startswith("~"):
        return "cannot be used (there is no such home folder)"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = path.stat()
        tempfile.TemporaryFile(dir=path).close()
    except OSError as error:
        return f"cannot be written to ({error.strerror or error})"
    if not hasattr(os, "geteuid"):  # Windows: a profile's folders are its user's own
        return ""
    if status.st_uid != os.geteuid():
        return "belongs to another user"
    return "can be written to by others" if stat.S_IMODE(status.st_mode) & 0o022 else ""


class FileCache(FunctionCache):
    """Numba's cache of one function, stored in files of ours; errors of a file never stop a run."""

    def __init__(self, numba_cache: FunctionCache, name: str) -> None:
        vars(self).update(vars(numba_cache))
        self._cache_file = _FunctionFiles(name)  # type: ignore[assignment]

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401  numba's own types
        """Return the function compiled for some types; None if it is not there, damaged or unreadable."""
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # whatever is wrong with the file, the function can be compiled
            return None

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401  numba's own types
        """Save a compiled function; on a full disk the next process compiles it again."""
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError:
            _unsaved.append(self._name)


_unsaved: list[str] = []


def compile_for(function: Any, *arguments: object) -> None:  # noqa: ANN401  numba's own type
    """Compile a function for some arguments, each given itself or by its type, or load it."""
    function.compile(
        tuple(
            one if isinstance(one, types.Type) else numba.typeof(one)  # type: ignore[no-untyped-call]
            for one in arguments
        )
    )


def is_complete(part: str) -> bool:
    """Return whether a part of the kernel (kernel, lanes, sensitivity) is compiled on disk."""
    return _stamp_path(part).is_file()


def mark_complete(part: str) -> None:
    """Record that all functions of a part are on disk, after a needle was simulated with them; skip it if one
    was not saved.
    """
    if not _unsaved:
        with suppress(OSError):
            _stamp_path(part).touch()


def _stamp_path(part: str) -> Path:
    return find_cache_folder().path / f"{part}.complete"


class _FunctionFiles:
    """The files of one function, one for each set of argument types."""

    def __init__(self, name: str) -> None:
        self._name = name

    def load(self, key: object) -> Any:  # noqa: ANN401  numba's own types
        path = self._path(key)
        try:
            content = path.read_bytes()
        except OSError:
            return None
        digest, data = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
        if hashlib.sha256(data).digest() != digest:
            return None
        return pickle.loads(data)  # noqa: S301  from the user's own folder, see above

    def save(self, key: object, value: object) -> None:
        path, data = self._path(key), dumps(value)  # type: ignore[no-untyped-call]
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            try:
                file.write(hashlib.sha256(data).digest() + data)
                file.close()
                Path(file.name).replace(path)
            except OSError:
                Path(file.name).unlink(missing_ok=True)
                raise

    def flush(self) -> None:
        for path in find_cache_folder().path.glob(f"{self._name}.*.compiled"):
            path.unlink(missing_ok=True)

    def _path(self, key: object) -> Path:
        types = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        return find_cache_folder().path / f"{self._name}.{types}.compiled"
