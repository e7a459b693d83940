"""Seconds that new processes take: Python alone, `import needlefit`, `--help`, `simulate phantom1`.

    python benchmarks/startup.py [--json] [--rounds N] [--beside-python PYTHON]

`--beside-python` measures the needlefit of another interpreter too, in turns; PYTHONPATH holds for this one
alone. Medians of the rounds, of the wall and of the processor, after one round that is not counted: it writes
bytecode and whatever else the first use keeps.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time

WAYS = {
    "python": ("-c", "pass"),
    "import needlefit": ("-c", "import needlefit"),
    "--help": ("-m", "needlefit", "--help"),
    "simulate": ("-m", "needlefit", "simulate", "phantom1"),
}
HERE, BESIDE = "", "beside "
NOT_PASSED_ON = {HERE: {"PYTHONDONTWRITEBYTECODE"}, BESIDE: {"PYTHONDONTWRITEBYTECODE", "PYTHONPATH"}}


def run(python: str, side: str, words: tuple[str, ...], folder: str) -> tuple[float, float]:
    """Return the wall's and the processor's time of a new process, s."""
    environment = {name: value for name, value in os.environ.items() if name not in NOT_PASSED_ON[side]}
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [python, *words], env=environment, cwd=folder, check=True, stdout=subprocess.DEVNULL
    )  # fmt: skip
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(pythons: dict[str, str], rounds: int) -> dict[str, dict[str, float]]:
    """Return the medians by side and way."""
    found: dict[str, list[tuple[float, float]]] = {side + way: [] for way in WAYS for side in pythons}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds + 1):
            for way, words in WAYS.items():
                for side, python in pythons.items():
                    found[side + way].append(run(python, side, words, folder))
    counted = {name: zip(*times[1:], strict=True) for name, times in found.items()}
    return {
        name: dict(zip(("wall", "processor"), map(statistics.median, times), strict=True))
        for name, times in counted.items()
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--beside-python", metavar="PYTHON", help="Interpreter of the other installation.")
    arguments = parser.parse_args()
    beside = {BESIDE: arguments.beside_python} if arguments.beside_python else {}
    figures = measure({HERE: sys.executable, **beside}, arguments.rounds)
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    print(f"medians, s; load average {os.getloadavg()[0]:.1f}")
    for way in WAYS:
        here = figures[way]
        text = ", ".join(f"{key} {value:.3f}" for key, value in here.items())
        if beside:
            other = figures[BESIDE + way]
            text += "; beside " + ", ".join(
                f"{key} {value:.3f} (ratio {here[key] / value:.2f})" for key, value in other.items()
            )
        print(f"{way}: {text}")


if __name__ == "__main__":
    main()
