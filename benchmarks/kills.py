"""Whether a run that is killed at random moments, again and again, ends with the bytes of one that is not.

    python benchmarks/kills.py [TARGET] [--kills 100] [--seed 1] [--out FOLDER]

Tunes and samples TARGET once undisturbed, then kills the same command (SIGKILL) at moments spread evenly over
the time that it took, goes on with --resume after each, and compares every file of both results but
timing.json. A run that ends before it is killed is begun afresh, with other numbers of threads in turn.
"""

import argparse
import random
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

NOT_CONVERGED = 5
"""Exit code of a run whose results are written, but marked."""


def command(target: str, out: Path, *options: str) -> list[str]:
    """Return the command that tunes and samples."""
    needlefit = [sys.executable, "-m", "needlefit"]
    return [*needlefit, "tune", target, "--sample", "--quiet", "--json", "--out", str(out), *options]


def ended(arguments: list[str], within: float | None) -> bool:
    """Run a command, killed after `within` seconds; return whether it ended by itself."""
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        _, said = process.communicate(timeout=within)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return False
    if process.returncode not in (0, NOT_CONVERGED):
        raise SystemExit(f"exit code {process.returncode}: {said}")
    return True


def contents(out: Path) -> dict[str, bytes]:
    """Return what a run wrote, without what depends on time."""
    (folder,) = (path for path in out.iterdir() if path.is_dir() and not path.name.startswith("."))
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "timing.json")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def main() -> None:
    """Kill, resume, compare, print; exit 1 if any byte differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", nargs="?", default="study2")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    chance = random.Random(options.seed)
    place = options.out or Path(tempfile.mkdtemp())
    begin = time.monotonic()
    ended(command(options.target, place / "whole"), None)
    seconds, whole = time.monotonic() - begin, contents(place / "whole")
    kills = rounds = 0
    different: set[str] = set()
    while kills < options.kills or not rounds:
        shutil.rmtree(place / "killed", ignore_errors=True)
        jobs = ("--jobs", str(1 + rounds % 2))
        done, resume = False, ()
        while not done:
            # after the last kill the run is left to end
            within = chance.uniform(0.1, seconds) if kills < options.kills else None
            done = ended(command(options.target, place / "killed", *jobs, *resume), within)
            kills, resume = kills + (not done), ("--resume",)
        rounds += 1
        again = contents(place / "killed")
        different |= {name for name in whole | again if whole.get(name) != again.get(name)}
    print(f"{options.target}: {seconds:.0f} s undisturbed, {len(whole)} files")
    print(f"{kills} kills in {rounds} runs: {sorted(different) or 'the same bytes in every file'}")
    sys.exit(1 if different else 0)


if __name__ == "__main__":
    main()
