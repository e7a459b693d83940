"""What a user waits for: whole commands, their processor time, where it goes, and the most memory.

    python benchmarks/whole_program.py [--json] [--commands help,study3] [--rounds 1] [--against FOLDER]
                                       [--profile] [--cold]

Runs commands as whole processes, in turns: those of this source tree and, with `--against`, of another one (a
checkout of an earlier revision). Other work stretches the wall; processor seconds (user and system, of all
processes of a command) and their ratio are what to compare. `--profile` runs each command once more and adds
up by package the time of its main thread: of each its own functions alone, imports included; the profiler
doubles what calls small functions. `--cold` gives numba an empty cache folder before every command, so that
the kernel is compiled again, as after a fresh install. Memory is the largest resident set of a process.
"""

import argparse
import json
import os
import pstats
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

COMMANDS = {
    "help": ("--help",),
    "simulate": ("simulate", "figure1"),
    "study1": ("validate", "study1", "-q", "--out", "reports"),
    "study3": ("validate", "study3", "-q", "--out", "reports"),
    "report": ("report", "reports/study3", "--out", "again", "-q"),
    "tune": ("tune", "phantom1", "-q", "--out", "reports"),
    "all": ("validate", "all", "-q", "--out", "reports"),
}
"""By name; `report` rewrites the result of `study3`."""

GOALS_S = {"simulate": 5.0, "study3": 5.0, "report": 3.0, "tune": 3.0, "all": 40.0}
"""Wall seconds on two free cores; of `simulate` after a fresh install."""

SHOWN_PACKAGES = 8

PROFILER = """
import cProfile, sys, time
sys.argv = ["needlefit", *sys.argv[2:]]
profile = cProfile.Profile(time.thread_time)
try:
    profile.runcall(lambda: __import__("needlefit.cli").cli.main())
finally:
    profile.dump_stats({file!r})
"""

Figures = dict[str, float]


def measure(arguments: list[str], folder: Path, environment: dict[str, str]) -> Figures:
    """Run a command to its end; return wall and processor seconds, and MiB."""
    begin = time.perf_counter()
    process = subprocess.Popen(arguments, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"failed: {' '.join(arguments)}")
    return {
        "wall_seconds": time.perf_counter() - begin,
        "processor_seconds": used.ru_utime + used.ru_stime,
        "memory_mib": used.ru_maxrss / 1024,  # KiB on Linux
    }


def profile(words: tuple[str, ...], folder: Path, environment: dict[str, str]) -> Figures:
    """Return the seconds of the main thread by package, the largest first."""
    file = folder / "profile"
    program = PROFILER.format(file=str(file))
    subprocess.run(
        [sys.executable, "-c", program, "-", *words],
        cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    found: Counter[str] = Counter()
    for (path, _, name), (_, _, own, *_) in pstats.Stats(str(file)).stats.items():  # type: ignore[attr-defined]
        found[_find_package(path, name)] += own
    return dict(found.most_common(SHOWN_PACKAGES))


def _find_package(path: str, name: str) -> str:
    """Return the package of a function, of needlefit's with the one below it."""
    parts = Path(path).parts
    if "needlefit" in parts:
        return ".".join(parts[len(parts) - parts[::-1].index("needlefit") - 1 :][:2]).removesuffix(".py")
    if "site-packages" in parts:
        return parts[parts.index("site-packages") + 1].removesuffix(".py")
    if "built-in" in name or path == "~":
        return "built-in functions"
    return "imports" if "importlib" in path else "standard library"


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--commands", default="help,simulate,study3,report,tune")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--cold", action="store_true")
    arguments = parser.parse_args()
    trees = {"": Path(__file__).parents[1], **({"before: ": arguments.against} if arguments.against else {})}
    found: dict[str, list[Figures]] = {}
    profiles: dict[str, Figures] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for turn in range(arguments.rounds):
            for name in arguments.commands.split(","):
                for label, tree in trees.items():
                    folder = Path(scratch, tree.name)
                    folder.mkdir(exist_ok=True)
                    environment = {**os.environ, "PYTHONPATH": str(tree.resolve())}
                    if arguments.cold:
                        environment["NEEDLEFIT_CACHE_DIR"] = tempfile.mkdtemp(dir=scratch)
                    command = [sys.executable, "-m", "needlefit", *COMMANDS[name]]
                    found.setdefault(label + name, []).append(measure(command, folder, environment))
                    if arguments.profile and turn == 0:
                        profiles[label + name] = profile(COMMANDS[name], folder, environment)
    figures = {
        name: {key: statistics.median(one[key] for one in rounds) for key in rounds[0]}
        for name, rounds in found.items()
    }
    if arguments.json:
        print(json.dumps({"figures": figures, "profiles": profiles}, indent=2))
        return
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for name, values in figures.items():
        goal = GOALS_S.get(name)
        print(
            f"{name:20s} {values['wall_seconds']:8.2f} s, {values['processor_seconds']:8.2f} s processor, "
            f"{values['memory_mib']:6.0f} MiB" + (f" (goal {goal:g} s on free cores)" if goal else "")
        )
        for package, share in profiles.get(name, {}).items():
            print(f"    {share:8.2f} s {package}")


if __name__ == "__main__":
    main()
