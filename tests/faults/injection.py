"""Count every step by which this process changes a folder, and spoil the n-th one.

A step is a system call seen from Python: opening a file for writing, every write of a buffer that is full or
flushed, fsync, rename, mkdir, unlink, rmdir, truncate, link. Files that HDF5 writes itself are steps when
they are opened, flushed and closed.
"""

import builtins
import errno
import io
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

Kind = Literal["kill", "full", "error"]
KINDS: tuple[Kind, ...] = ("kill", "full", "error")
"""The process is killed at the step; from the step on the disk is full; the step alone fails (EIO)."""

TAKING = frozenset(("open", "write", "mkdir", "link", "symlink", "fsync", "h5py"))
"""Steps that want space: those that a full disk refuses."""


@dataclass
class Injector:
    """The steps below `root` so far, and which one is spoiled; `at` 0 spoils none."""

    root: Path
    at: int = 0
    kind: Kind = "kill"
    steps: list[str] = field(default_factory=list)

    def step(self, what: str, path: object) -> None:
        """Count a step on a path; kill the process or raise OSError if it is the one."""
        if not self.covers(path):
            return
        self.steps.append(f"{what} {path}")
        if self.spoils(what):
            self.spoil(path)

    def spoils(self, what: str) -> bool:
        """Whether the step that was counted last fails."""
        now = len(self.steps)
        if self.kind == "full":
            return 0 < self.at <= now and what in TAKING
        return now == self.at

    def spoil(self, path: object) -> None:
        """End the process as `kill -9` does, or raise what the system does."""
        if self.kind == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        code = errno.ENOSPC if self.kind == "full" else errno.EIO
        raise OSError(code, os.strerror(code), str(path))

    def covers(self, path: object) -> bool:
        """Whether a path lies below the root; one that is relative to an open folder counts as such."""
        if isinstance(path, int):
            try:
                path = Path(f"/proc/self/fd/{path}").readlink()
            except OSError:
                return False
        text = os.fsdecode(path) if isinstance(path, str | bytes | os.PathLike) else ""
        return (self.root / text).is_relative_to(self.root) and ".." not in Path(text).parts


class _File(io.FileIO):
    """A file whose writes are steps; of the one that is spoiled half is written."""

    injector: Injector
    shown: str

    def write(self, data: Any) -> int:
        injector = self.injector
        injector.steps.append(f"write {self.shown}")
        if injector.spoils("write"):
            super().write(memoryview(data).cast("B")[: len(memoryview(data).cast("B")) // 2])
            injector.spoil(self.shown)
        return super().write(data)


def install(injector: Injector) -> None:
    """Put the counting functions in the place of Python's own, for the rest of the process."""
    for name in ("rename", "replace", "mkdir", "unlink", "remove", "rmdir", "truncate", "link", "symlink"):
        setattr(os, name, _counted(injector, name, getattr(os, name)))
    for name, step in (("fsync", "fsync"), ("ftruncate", "truncate"), ("fdatasync", "fsync")):
        setattr(os, name, _counted(injector, step, getattr(os, name)))
    os.write = _counted(injector, "write", os.write)  # type: ignore[assignment]
    os.open = _os_open(injector, os.open)  # type: ignore[assignment]
    builtins.open = io.open = _open(injector, io.open)  # type: ignore[assignment]
    _install_hdf5(injector)


def _counted(injector: Injector, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
    name = {"remove": "unlink", "replace": "rename"}.get(name, name)

    def counted(path: Any, *args: Any, **kwargs: Any) -> Any:
        folder = kwargs.get("dir_fd")
        shown = path
        if folder is not None:
            shown = Path(f"/proc/self/fd/{folder}").readlink() / os.fsdecode(path)
        injector.step(name, shown)
        return real(path, *args, **kwargs)

    return counted


def _os_open(injector: Injector, real: Callable[..., int]) -> Callable[..., int]:
    def opened(path: Any, flags: int, *args: Any, **kwargs: Any) -> int:
        if flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            injector.step("open", path)
        return real(path, flags, *args, **kwargs)

    return opened


def _open(injector: Injector, real: Callable[..., Any]) -> Callable[..., Any]:
    def opened(
        file: Any, mode: str = "r", buffering: int = -1, encoding=None, errors=None, newline=None, **more: Any
    ) -> Any:
        writes = set(mode) & set("wax+")
        if not writes or isinstance(file, int) or more or not injector.covers(file):
            return real(file, mode, buffering, encoding, errors, newline, **more)
        injector.step("open", file)
        raw = _File(file, mode.replace("b", "").replace("t", ""))
        raw.injector, raw.shown = injector, str(file)
        if buffering == 0:
            return raw
        whole = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return whole if "b" in mode else io.TextIOWrapper(whole, encoding, errors, newline, buffering == 1)

    return opened


def _install_hdf5(injector: Injector) -> None:
    try:
        import h5py
    except ImportError:
        return
    begin, close = h5py.File.__init__, h5py.File.close

    def opened(self: Any, name: Any, mode: str = "r", *args: Any, **kwargs: Any) -> None:
        if mode != "r" and isinstance(name, str | bytes | os.PathLike):
            injector.step("h5py", name)
        begin(self, name, mode, *args, **kwargs)

    def closed(self: Any) -> None:
        if self.id.valid and self.mode != "r" and isinstance(self.filename, str):
            injector.step("h5py", self.filename)
        close(self)

    h5py.File.__init__, h5py.File.close = opened, closed
