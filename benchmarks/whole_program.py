"""What a user waits for: whole commands, their processor time, where it goes, and the most memory.

    python benchmarks/whole_program.py [--json] [--commands help,study3] [--rounds 1] [--beside-python PYTHON]
                                       [--profile]

Runs commands as whole processes, in turns: those of this source tree and, with `--beside-python`, those of
another interpreter's needlefit, such as one of commit 1e6ded96. Other work stretches the wall; processor
seconds (user and system, of all processes of a command) and their ratio are what to compare. `--profile` runs
each command once more with `--jobs 1`, looks every 4 ms of processor time where it is, and adds up: by
package, of each its own functions alone, and by function with what that calls. A profiler that counts calls
would double what calls small functions. Memory is the largest resident set of a process.
"""

import argparse
import json
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from in_turns import BESIDE, HERE, Program, add_beside_python, list_programs

COMMANDS = {
    "help": ("--help",),
    "simulate": ("simulate", "figure1"),
    "study1": ("validate", "study1", "-q", "--out", "reports"),
    "study3": ("validate", "study3", "-q", "--out", "reports"),
    "report": ("report", "reports/study3", "--out", "again", "-q"),
    "tune": ("tune", "phantom1", "-q", "--out", "reports"),
    "design": ("tune", "study1", "--design", "-q", "--out", "reports"),
    "predict": ("predict", "study2", "--scene", "study2", "-q", "--out", "reports"),
    "all": ("validate", "all", "-q", "--out", "reports"),
}
"""By name; `report` rewrites the result of `study3`."""

SHOWN_PACKAGES, SHOWN_FUNCTIONS = 8, 10

MAX_SHARE = 0.9
"""Functions that take more of a command than this only call the others."""

PROFILER = """
import collections, json, os, signal, sys, time
file, sys.argv = sys.argv[1], ["needlefit", *sys.argv[2:]]
own, whole = collections.Counter(), collections.Counter()
def look(_, frame):
    others = [other for other in sys._current_frames().values() if other.f_code is not look.__code__]
    waits = ("threading.py", "futures/thread.py")  # as the main thread does while searches compute in others
    working = [some for some in (frame, *others) if not some.f_code.co_filename.endswith(waits)]
    frame = (working or [frame])[0]
    seen, own_code = set(), frame.f_code
    while frame:
        seen.add(frame.f_code)
        frame = frame.f_back
    own[own_code] += 1
    whole.update(seen)
signal.signal(signal.SIGPROF, look)
signal.setitimer(signal.ITIMER_PROF, 0.004, 0.004)
process = os.getpid()
try:
    __import__("needlefit.cli").cli.main()
finally:
    signal.setitimer(signal.ITIMER_PROF, 0)
    if os.getpid() == process:  # and no copy that draws figures
        tables = [[(c.co_filename, c.co_qualname, n) for c, n in t.items()] for t in (own, whole)]
        with open(file, "w") as text:
            json.dump([time.process_time() / own.total(), *tables], text)
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


def profile(words: tuple[str, ...], folder: Path, program: Program) -> dict[str, Figures]:
    """Return the seconds by package and by function, the largest first; of the threads that do not wait."""
    file, (python, environment) = folder / "profile", program
    one_thread = ("--jobs", "1") if words[0] in ("validate", "tune") else ()
    subprocess.run(
        [python, "-c", PROFILER, str(file), *words, *one_thread],
        cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    seconds, own, whole = json.loads(file.read_text())
    packages: Figures = {}
    for path, _, count in own:
        package = _find_package(path)
        packages[package] = packages.get(package, 0.0) + count * seconds
    most = MAX_SHARE * sum(packages.values())
    functions = {
        f"{_find_package(path)} {name}": count * seconds
        for path, name, count in whole
        if "needlefit" in path and count * seconds < most
    }
    return {"packages": _sort(packages, SHOWN_PACKAGES), "functions": _sort(functions, SHOWN_FUNCTIONS)}


def _compare(figures: dict[str, Figures], name: str) -> str:
    """Return the ratio of a command's processor seconds to those of the interpreter beside."""
    key, beside = "processor_seconds", figures.get(f"{BESIDE}: {name}")
    return f", ratio {figures[name][key] / beside[key]:.2f}" if beside else ""


def _sort(values: Figures, most: int) -> Figures:
    return dict(sorted(values.items(), key=lambda item: -item[1])[:most])


def _find_package(path: str) -> str:
    """Return the package of a file, of needlefit's with the one below it."""
    parts = Path(path).parts
    if "needlefit" in parts:
        return ".".join(parts[len(parts) - parts[::-1].index("needlefit") - 1 :][:2]).removesuffix(".py")
    if "site-packages" in parts:
        return parts[parts.index("site-packages") + 1].removesuffix(".py")
    return "imports" if "importlib" in path else "standard library"


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--commands", default="help,simulate,study3,report,tune")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--profile", action="store_true")
    add_beside_python(parser)
    arguments = parser.parse_args()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else each command compiles every module of Python
    found: dict[str, list[Figures]] = {}
    profiles: dict[str, dict[str, Figures]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for turn in range(arguments.rounds):
            for name in arguments.commands.split(","):
                for where, program in list_programs(arguments.beside_python).items():
                    folder, label = Path(scratch, where), name if where == HERE else f"{where}: {name}"
                    folder.mkdir(exist_ok=True)
                    python, environment = program
                    command = [python, "-m", "needlefit", *COMMANDS[name]]
                    found.setdefault(label, []).append(measure(command, folder, environment))
                    if arguments.profile and turn == 0:
                        profiles[label] = profile(COMMANDS[name], folder, program)
    figures = {
        name: {key: statistics.median(one[key] for one in rounds) for key in rounds[0]}
        for name, rounds in found.items()
    }
    if arguments.json:
        print(json.dumps({"figures": figures, "profiles": profiles}, indent=2))
        return
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for name, values in figures.items():
        print(
            f"{name:20s} {values['wall_seconds']:8.2f} s, {values['processor_seconds']:8.2f} s processor, "
            f"{values['memory_mib']:6.0f} MiB" + _compare(figures, name)
        )
        for kind, shares in profiles.get(name, {}).items():
            print(f"    {kind}")
            for what, share in shares.items():
                print(f"    {share:8.2f} s {what}")


if __name__ == "__main__":
    main()
