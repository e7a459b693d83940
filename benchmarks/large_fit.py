"""One fit of many insertions: processor time of a Jacobian for each of them, and the most memory.

    python benchmarks/large_fit.py [--insertions 10,50,200,500] [--sets 1,16]

Insertions are copies of those of the fit `phantom1`, each set of ten in a specimen of its own. Searches
evaluate up to 16 sets of values together. Each line is of a process of its own.
"""

import argparse
import subprocess
import sys
import time
from dataclasses import replace
from resource import RUSAGE_SELF, getrusage

from sampling import prepare_target


def measure(count, sets):
    """Print the time of Jacobians of so many insertions and sets of values, and the most memory so far."""
    job = prepare_target("phantom1")
    one = job.problem(job.folds[0]).searched
    copies = []
    for n in range(count):
        set_number, place = divmod(n, len(one.insertions))
        like = one.insertions[place]
        copies.append(replace(like, id=f"copy-{n}", specimen=f"{like.specimen}-{set_number}"))
    dataset = replace(one.dataset, insertions=tuple(copies))
    problem = replace(one, dataset=dataset, insertions=tuple(copies))
    values = [problem.values(problem.parameters.expected)] * sets
    problem.density.jacobians(values[:1])  # what is prepared once
    begin = time.process_time()
    problem.density.jacobians(values)
    each = 1e3 * (time.process_time() - begin) / count / sets
    memory = getrusage(RUSAGE_SELF).ru_maxrss / 1024
    print(f"{count:4} insertions, {sets:2} sets: {each:.2f} ms an insertion and set, {memory:.0f} MiB")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--insertions", default="10,50,200,500")
    parser.add_argument("--sets", default="1,16")
    arguments = parser.parse_args()
    counts, sets = (list(map(int, text.split(","))) for text in (arguments.insertions, arguments.sets))
    if len(counts) == len(sets) == 1:
        measure(*counts, *sets)
        return
    for size in sets:
        for count in counts:
            own = ["--insertions", str(count), "--sets", str(size)]
            subprocess.run([sys.executable, __file__, *own], check=True)


if __name__ == "__main__":
    main()
