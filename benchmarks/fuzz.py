"""Damaged inputs by the thousand: whether any of them does more than be read or refused.

    python benchmarks/fuzz.py --minutes 60 [--jobs 2] [--reader NAME] [--seed 1] [--keep FOLDER] [--out FILE]

Every reader of what comes from outside (`tests/fuzzing/readers.py`) reads valid inputs that were damaged at
random. Allowed is a value or a `NeedlefitError`, within 10 s of processor time and 1 GB. An input that does
anything else (another exception, a crash, control characters in a message) is copied to the folder of --keep,
with what happened. The same seed gives the same mutants: `--only N` reads one of them again, and with --out
an interrupted campaign goes on where it was.
"""

import argparse
import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from queue import Queue

PROJECT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(PROJECT / "tests"), str(PROJECT), str(PROJECT / "benchmarks")]

from fuzzing.campaign import Workers  # noqa: E402
from fuzzing.readers import READERS  # noqa: E402
from fuzzing.worker import Verdict  # noqa: E402

SHARE = 40
"""Mutants that a process reads of one reader before it turns to the next."""

Counts = dict[str, dict[str, float]]
"""Of each reader: mutants, accepted, refused, violations, processor time (s), slowest, MiB, time (s)."""


def empty() -> dict[str, float]:
    """Return the counts of a reader of which nothing has been read."""
    return dict.fromkeys(
        ("mutants", "accepted", "refused", "violations", "seconds", "slowest", "mib", "wall"), 0
    )


def count(counts: Counts, verdict: Verdict) -> None:
    """Add a verdict."""
    of = counts[verdict.reader]
    of["mutants"] += 1
    of["violations" if verdict.outcome == "violation" else verdict.outcome] += 1
    of["seconds"] += verdict.seconds
    of["slowest"] = max(of["slowest"], verdict.seconds)
    of["mib"] = max(of["mib"], verdict.mib)


def shares(readers: Sequence[str], counts: Mapping[str, Mapping[str, float]]) -> Iterator[tuple[str, range]]:
    """Yield without end which mutants of which reader are next.

    It is the one with the least product of mutants and time so far: slow readers get more time than fast
    ones, and fast ones more mutants.
    """
    begun = {name: int(counts[name]["mutants"]) for name in readers}
    while True:
        name = min(readers, key=lambda one: begun[one] * (1.0 + counts[one]["wall"]))
        yield name, range(begun[name], begun[name] + SHARE)
        begun[name] += SHARE


def campaign(options: argparse.Namespace, counts: Counts) -> None:
    """Read mutants in `options.jobs` processes until the time is over; counts are kept after each share."""
    turns, lock, done = shares(options.reader, counts), threading.Lock(), Queue[None]()
    end = time.monotonic() + 60 * options.minutes

    def work() -> None:
        with Workers() as workers:
            while time.monotonic() < end:
                with lock:
                    name, numbers = next(turns)
                began = time.monotonic()
                verdicts = list(workers.verdicts(name, numbers, options.seed, options.keep))
                with lock:
                    counts[name]["wall"] += time.monotonic() - began
                    for verdict in verdicts:
                        count(counts, verdict)
                        if verdict.outcome == "violation":
                            print(f"{name} {verdict.number}: {verdict.detail[:300]}", flush=True)
                    keep(options, counts)
                    progress(counts, end)
        done.put(None)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(options.jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def progress(counts: Counts, end: float) -> None:
    """Print one line that replaces itself on a terminal, and is left out elsewhere."""
    if sys.stderr.isatty():
        total = sum(int(of["mutants"]) for of in counts.values())
        left = max(0.0, end - time.monotonic()) / 60
        print(f"\r{total} mutants, {left:.1f} min left ", end="", file=sys.stderr, flush=True)


def keep(options: argparse.Namespace, counts: Counts) -> None:
    """Write the counts so far, whole or not at all."""
    if options.out is None:
        return
    fresh = options.out.with_name(f"{options.out.name}.new")
    fresh.write_text(json.dumps({"seed": options.seed, "readers": counts}, indent=1) + "\n")
    fresh.replace(options.out)


def rows(counts: Counts) -> list[tuple[str, ...]]:
    """Return the table's cells, its head first and the sum last."""
    head = ("reader", "mutants", "read", "refused", "violations", "slowest (s)", "memory (MiB)")
    listed = {name: of for name, of in counts.items() if of["mutants"]}
    total = dict(sum((Counter(of) for of in listed.values()), Counter()))
    if listed:
        total |= {key: max(of[key] for of in listed.values()) for key in ("slowest", "mib")}
    body = [
        (
            name,
            *(
                f"{int(of.get(key, 0)):,}".replace(",", " ")
                for key in ("mutants", "accepted", "refused", "violations")
            ),
            f"{of.get('slowest', 0):.2f}",
            f"{of.get('mib', 0):.0f}",
        )
        for name, of in [*listed.items(), ("all", total)]
    ]
    return [head, *body]


def show(counts: Counts) -> None:
    """Print the table."""
    cells = rows(counts)
    widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
    for row in cells:
        print(
            "  ".join(
                cell.ljust(w) if k == 0 else cell.rjust(w)
                for k, (cell, w) in enumerate(zip(row, widths, strict=True))
            )
        )


def again(reader: str, number: int, seed: int) -> None:
    """Read one mutant and print what came of it."""
    with Workers() as workers:
        workers.inputs(reader)
        (verdict,) = workers.verdicts(reader, [number], seed)
    print(f"{reader} {number}: {verdict.outcome}, {verdict.seconds:.2f} s, {verdict.mib:.0f} MiB")
    print(verdict.detail)


def main() -> None:
    """Run a campaign; exit 1 if anything was against the rule."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--reader", action="append", choices=list(READERS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.only is not None:
        for reader in options.reader or READERS:
            again(reader, options.only, options.seed)
        return
    stored = json.loads(options.out.read_text()) if options.out and options.out.is_file() else {}
    if stored and stored["seed"] != options.seed:
        parser.error(f"{options.out} is of seed {stored['seed']}")
    counts = {name: stored.get("readers", {}).get(name, empty()) for name in READERS}
    options.reader = options.reader or list(READERS)
    campaign(options, counts)
    show(counts)
    sys.exit(1 if any(of["violations"] for of in counts.values()) else 0)


if __name__ == "__main__":
    main()
