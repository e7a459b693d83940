"""Whether a run that is killed at random moments, again and again, ends with the bytes of one that is not.

    python benchmarks/kills.py [TARGET] [--kills 100] [--seed 1] [--out FOLDER]

Tunes and samples TARGET once undisturbed, then kills the same command (SIGKILL) at moments spread evenly over
the processor time that it took, goes on with --resume after each, and compares every file of both results but
timing.json. After five kills a run is left to end; when it has ended another is begun, with other numbers of
threads in turn.
Without TARGET: two insertions into chicken, eight starts with approach and second fit, and a sampler that
stops after 300 steps, kept every 10. With --out every kill is written to FOLDER/kills.jsonl, with what had
been kept by then; the same command goes on counting there.
"""

import argparse
import json
import math
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

NOT_CONVERGED = 5
"""Exit code of a run whose results are written, but marked."""

KILLS_PER_RUN = 5
"""Kills of one run, after which it is left to end: on a busy machine it might never."""

RECIPE = """
schema = 3
metric = true
starts = 8

[sample]
walkers = 8
densities = 2400
"""

FIT = """
schema = 1
dataset = "twin"
medium = "chicken"
recipe = "{recipe}"

[tune]
insertions = ["chicken-04", "chicken-10"]
"""


def small(place: Path) -> str:
    """Write a fit that takes seconds; return its path."""
    (place / "recipe.toml").write_text(RECIPE)
    (place / "small.toml").write_text(FIT.format(recipe=place / "recipe.toml"))
    return str(place / "small.toml")


def command(target: str, out: Path, *options: str) -> list[str]:
    """Return the command that tunes and samples."""
    needlefit = [sys.executable, "-m", "needlefit"]
    return [*needlefit, "tune", target, "--quiet", "--json", "--out", str(out), *options]


def spent(process: int) -> float:
    """Return the processor time of a process so far, s; 0 once it is gone."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def ended(arguments: list[str], within: float) -> bool:
    """Run a command, killed after `within` seconds of processor time; return whether it ended by itself."""
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=errors)
        while process.poll() is None:
            if spent(process.pid) > within:
                process.kill()
                process.wait()
                return False
            time.sleep(0.05)
        if process.returncode not in (0, NOT_CONVERGED):
            errors.seek(0)
            raise SystemExit(f"exit code {process.returncode}: {errors.read()}")
    return True


def contents(out: Path) -> dict[str, bytes]:
    """Return what a run wrote, without what depends on time."""
    (folder,) = (path for path in out.iterdir() if path.is_dir() and not path.name.startswith("."))
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "timing.json")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def kept(out: Path) -> str:
    """Return how far a killed run had come, by its checkpoint."""
    rows = [path.read_text() for path in out.glob("*.partial/*.jsonl")]
    blocks = sum(text.count('"begin":') for text in rows)
    starts = sum(text.count("{") for text in rows)
    return "sampling" if blocks else "starts ended" if starts else "nothing kept yet"


def undisturbed(target: str, place: Path) -> tuple[float, dict[str, bytes]]:
    """Return the processor time of the command and what it writes; once for all, where `place` has it."""
    took = place / "seconds.json"
    if not took.is_file():
        shutil.rmtree(place / "whole", ignore_errors=True)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        ended(command(target, place / "whole"), math.inf)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        took.write_text(json.dumps(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime))
    return json.loads(took.read_text()), contents(place / "whole")


def killed(target: str, place: Path, jobs: int, moments: Iterator[float]) -> Iterator[dict[str, object]]:
    """Yield every kill of one run, killed after each of `moments`, until it ends by itself."""
    shutil.rmtree(place / "killed", ignore_errors=True)
    resume: tuple[str, ...] = ()
    while True:
        # after the last moment the run is left to end
        within = next(moments, math.inf)
        if ended(command(target, place / "killed", "--jobs", str(jobs), *resume), within):
            return
        resume = ("--resume",)
        yield {"seconds": within, "kept": kept(place / "killed")}


def main() -> None:
    """Kill, resume, compare, print; exit 1 if any byte differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", nargs="?")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    place = (options.out or Path(tempfile.mkdtemp())).resolve()
    place.mkdir(parents=True, exist_ok=True)
    target = options.target or small(place)
    seconds, whole = undisturbed(target, place)
    log = place / "kills.jsonl"
    rounds = [json.loads(line) for line in log.read_text().splitlines()] if log.is_file() else []
    while (count := sum(len(one["kills"]) for one in rounds)) < options.kills or not rounds:
        chance = random.Random(options.seed + len(rounds))
        moments = (chance.uniform(0.1, seconds) for _ in range(min(KILLS_PER_RUN, options.kills - count)))
        kills = list(killed(target, place, 1 + len(rounds) % 2, moments))
        again = contents(place / "killed")
        different = sorted(name for name in whole | again if whole.get(name) != again.get(name))
        rounds.append({"kills": kills, "different": different})
        with log.open("a") as file:
            file.write(json.dumps(rounds[-1]) + "\n")
    report(Path(target).stem, seconds, len(whole), rounds)


def report(name: str, seconds: float, files: int, rounds: list[dict[str, list]]) -> None:
    """Print the kills, how far runs had come when they were killed, and what differs; exit 1 if any does."""
    kills = [kill for one in rounds for kill in one["kills"]]
    different = sorted({file for one in rounds for file in one["different"]})
    print(f"{name}: {seconds:.0f} s of processor time undisturbed, {files} files")
    print(f"{len(kills)} kills in {len(rounds)} runs: {different or 'the same bytes in every file'}")
    print("killed with: " + ", ".join(f"{what} {n}" for what, n in Counter(k["kept"] for k in kills).items()))
    sys.exit(1 if different else 0)


if __name__ == "__main__":
    main()
