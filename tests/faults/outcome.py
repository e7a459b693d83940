"""A command with a fault at one step: what stood afterwards, and what going on gave."""

import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from faults.commands import COMMANDS, FOREIGN, Command, write_inputs
from faults.injection import TAKING
from faults.server import Server

REFUSED = (3, 4)
"""Exit codes of a command that says what the disk did."""

Files = dict[str, bytes]


@dataclass(frozen=True)
class Prepared:
    """A command with its folder before it, and what it leaves where nothing goes wrong.

    The folder `before` has inputs, somebody's own files, and an earlier result; `old` and `new` are the
    result's files before and after, `steps` those by which it wrote, `left` is all that lies there then.
    """

    command: Command
    before: Path
    old: Files
    new: Files
    code: int
    steps: tuple[str, ...]
    left: frozenset[str]

    def faults(self, kinds: tuple[str, ...]) -> Iterator[tuple[str, int]]:
        """Yield every fault there is; a full disk begins at a step that wants space."""
        for kind in kinds:
            for number, step in enumerate(self.steps, start=1):
                if kind != "full" or step.split(" ")[0] in TAKING:
                    yield kind, number


def prepare(name: str, folder: Path, server: Server) -> Prepared:
    """Run a command where nothing goes wrong, in `folder`/work; its folder before it is kept beside."""
    command, work = COMMANDS[name], folder / "work"
    shutil.rmtree(folder, ignore_errors=True)
    write_inputs(work)
    for words in command.earlier:
        done = server.run(words, work)
        if done["code"] not in (0, 5):
            raise RuntimeError(f"{words}: {done['err']}")
    old = contents(work / command.out)
    shutil.copytree(work, folder / "before", symlinks=True)
    done = server.run(command.words, work)
    if done["code"] not in (0, 5):
        raise RuntimeError(f"{command.words}: {done['err']}")
    new = contents(work / command.out)
    if old == new:
        raise RuntimeError(f"{name}: the result before is the one after")
    steps = tuple(done["steps"])
    return Prepared(command, folder / "before", old, new, done["code"], steps, _everything(work))


def spoil(prepared: Prepared, fault: tuple[str, int], server: Server) -> list[str]:
    """Run the command with a fault, and go on; return what was against the promises, empty if nothing."""
    command, work = prepared.command, prepared.before.parent / "work"
    shutil.rmtree(work)
    shutil.copytree(prepared.before, work, symlinks=True)
    done = server.run(command.words, work, fault)
    stands = contents(work / command.out)
    wrong = [*_ending(prepared, fault[0], done["code"], done["err"]), *_foreign(work)]
    if stands not in (prepared.old, prepared.new):
        wrong.append(f"neither the old result nor the new one stands: {_unlike(stands, prepared)}")
    if done["code"] == prepared.code and stands != prepared.new:
        wrong.append("it ended well without the new result")
    again = server.run((*command.words, *(["--resume"] if command.resumes else [])), work)
    if again["code"] != prepared.code:
        wrong.append(f"going on ended with {again['code']}: {again['err'][-300:]}")
    elif contents(work / command.out) != prepared.new:
        wrong.append(f"going on gave other bytes: {_unlike(contents(work / command.out), prepared)}")
    more = sorted(_everything(work) ^ prepared.left) if again["code"] == prepared.code else []
    return [*wrong, *_foreign(work), *([f"left behind or missing: {more[:4]}"] if more else [])]


def contents(folder: Path) -> Files:
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name != "timing.json")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _everything(folder: Path) -> frozenset[str]:
    """Return what lies in a folder, but for scratch folders that hold no file, or a lock alone.

    One of a process that was killed before it had its lock could belong to a process that begins just now.
    """
    paths = [path.relative_to(folder) for path in folder.rglob("*")]
    scratch = {
        path.parts[: n + 1] for path in paths for n, part in enumerate(path.parts) if _SCRATCH.match(part)
    }
    kept = {
        top for top in scratch for path in paths
        if path.parts[: len(top)] == top and (folder / path).is_file() and not path.name.startswith("lock")
    }  # fmt: skip
    return frozenset(
        path.as_posix() for path in paths
        if not any(path.parts[: len(top)] == top for top in scratch - kept)
    )  # fmt: skip


_SCRATCH = re.compile(r"\..+\.needlefit-")


def _ending(prepared: Prepared, kind: str, code: int, err: str) -> list[str]:
    if kind == "kill":
        return [] if code == -9 else [f"it was not killed, but ended with {code}"]
    if code not in (prepared.code, *REFUSED) or "Traceback" in err:
        return [f"it ended with {code}: {err[-300:]}"]
    return []


def _foreign(folder: Path) -> list[str]:
    return [
        f"{name} of somebody else was touched"
        for name, text in FOREIGN.items()
        if not (folder / name).is_file() or (folder / name).read_text() != text
    ]


def _unlike(stands: Files, prepared: Prepared) -> str:
    if not stands:
        return "nothing stands"
    nearer = min((prepared.old, prepared.new), key=lambda files: len(_differing(stands, files)))
    return f"{_differing(stands, nearer)[:4]}"


def _differing(one: Files, two: Files) -> list[str]:
    return sorted(name for name in one.keys() | two.keys() if one.get(name) != two.get(name))
