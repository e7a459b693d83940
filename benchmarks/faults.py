"""Faults at every step: whether a full disk, a failing disk or `kill -9` ever loses anything.

    python benchmarks/faults.py [--command NAME] [--every 1] [--jobs 2] [--out FILE]

Each command (`tests/faults/commands.py`, on tiny inputs) is run once where nothing goes wrong, and its steps
are counted: every opening for writing, write, fsync, rename, mkdir, unlink, rmdir, truncate. Then it is run
once for each step and kind of fault: killed at the step, the disk full from there on, that step failing
(EIO). Afterwards the old result or the new one must stand, byte for byte, other files be as they were, and
going on (`--resume`, or the command again) give the bytes of the first run and leave nothing behind. Figures
and PDFs are stubs; NEEDLEFIT_FAULTS_DRAW=1 draws them. --every 5 takes every fifth fault; with --out an
interrupted campaign goes on.
"""

import argparse
import json
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(PROJECT / "tests"), str(PROJECT), str(PROJECT / "benchmarks")]

from faults.commands import COMMANDS  # noqa: E402
from faults.injection import KINDS  # noqa: E402
from faults.outcome import prepare, spoil  # noqa: E402
from faults.server import Server  # noqa: E402

Found = dict[str, dict]
"""Of each command: its number of steps, the faults tried ("kill 12"), and what was wrong with which."""


class Campaign:
    """The faults that are left, shared by the threads of the jobs."""

    def __init__(self, options: argparse.Namespace, found: Found) -> None:
        self._options, self._found, self._lock = options, found, threading.Lock()
        self._names = iter(options.command)

    def work(self, folder: Path) -> None:
        """Take one command after the other, with a warm process of its own."""
        with Server() as server:
            while name := self._next():
                prepared = prepare(name, folder / name.replace(" ", "_"), server)
                for fault in list(prepared.faults(KINDS))[:: self._options.every]:
                    label = f"{fault[0]} {fault[1]}"
                    if label in self._found[name]["tried"]:
                        continue
                    why = spoil(prepared, fault, server)
                    self._keep(name, label, prepared.steps, fault[1], why)

    def _next(self) -> str | None:
        with self._lock:
            return next(self._names, None)

    def _keep(self, name: str, label: str, steps: tuple[str, ...], number: int, why: list[str]) -> None:
        with self._lock:
            of = self._found[name]
            of["steps"] = len(steps)
            of["tried"].append(label)
            if why:
                of["wrong"][label] = why
                print(f"{name}, {label}, {steps[number - 1]}: {why}", flush=True)
            if self._options.out:
                fresh = self._options.out.with_name(f"{self._options.out.name}.new")
                fresh.write_text(json.dumps(self._found, indent=1) + "\n")
                fresh.replace(self._options.out)


def rows(found: Found) -> list[tuple[str, ...]]:
    """Return the table's cells, its head first and the sum last."""
    head = ("command", "steps", "killed", "disk full", "disk error", "promises broken")
    body = []
    for name, of in found.items():
        kinds = Counter(label.split(" ")[0] for label in of["tried"])
        if of["tried"]:
            body.append((name, of["steps"], *(kinds[kind] for kind in KINDS), len(of["wrong"])))
    total = tuple(sum(column) for column in list(zip(*body, strict=True))[1:]) if body else (0,) * 5
    return [head, *(tuple(map(str, row)) for row in [*body, ("all", *total)])]


def main() -> None:
    """Run a campaign and print its table; exit 1 if a promise was broken."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--command", action="append", choices=list(COMMANDS))
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    options.command = options.command or list(COMMANDS)
    stored = json.loads(options.out.read_text()) if options.out and options.out.is_file() else {}
    found: Found = {name: stored.get(name) or {"steps": 0, "tried": [], "wrong": {}} for name in COMMANDS}
    campaign, began = Campaign(options, found), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="needlefit-faults-") as folder:
        threads = [
            threading.Thread(target=campaign.work, args=(Path(folder) / str(n),)) for n in range(options.jobs)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    for row in rows(found):
        print(f"{row[0]:<15}" + "".join(f"{cell:>17}" for cell in row[1:]))
    print(f"{time.monotonic() - began:.0f} s")
    sys.exit(1 if any(of["wrong"] for of in found.values()) else 0)


if __name__ == "__main__":
    main()
