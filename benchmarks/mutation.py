"""Mutation testing: whether the tests notice when the code is changed.

    python -m pip install cosmic-ray
    python benchmarks/mutation.py [AREA ...] [--mutants 26] [--seed 17] [--out FILE [--again]]

In each area so many places are drawn at random, and of each place one of the changes that cosmic-ray knows:
another operator, number or comparison, a condition negated, a loop left out. Each is made alone in a copy of
the project, and the area's tests run on it until one fails. A mutant that no test notices has survived.
With --out an interrupted run goes on. Changes of annotations and decorators are left out, and so are
replacements that fail on every number (`a << b` for `a * b`).

Each run is forked from this process, which has loaded the libraries. Its processor time is limited to five
times that of the area's unchanged tests: a mutant that runs longer counts as killed.
"""

import argparse
import ast
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Area:
    """Modules that are mutated (files or folders below `needlefit`), and the test files that run on them.

    `without`: a folder of these that is left out.
    """

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    without: str = ""


AREAS = {
    "likelihood": Area(
        ("inference/likelihood", "inference/posterior_density.py"),
        (
            *("inference_likelihood", "inference_slopes", "inference_tracks"),
            *("inference_marginal", "inference_depths"),
        ),
    ),
    "sampling": Area(("inference/sampling",), ("inference_convergence", "inference_sample")),
    "importance": Area(
        ("inference/importance",),
        ("inference_predictive_density", "inference_importance", "inference_specimens"),
    ),
    "metrics": Area(
        ("metrics", "geometry/compare.py"), ("inference_metric", "registry", "geometry", "reporting_tables")
    ),
    "registration": Area(
        ("imaging/registration", "geometry/frames.py"),
        ("imaging_registration_faults", "geometry", "imaging_registration"),
    ),
    "resume": Area(
        ("studies/checkpoint.py", "project/checkpoint_file.py", "project/checkpoint_folder.py"),
        ("project_checkpoint_file", "validation_checkpoint", "project_ownership"),
    ),
    "mechanics": Area(
        ("mechanics",),
        (
            *("mechanics_laws", "mechanics_closed_forms", "mechanics_model", "mechanics_rules"),
            *("mechanics_controls", "mechanics_plan", "mechanics_scene", "mechanics_session"),
            *("mechanics_session_again", "mechanics_session_failures", "mechanics_sensitivity"),
            *("mechanics_lanes", "mechanics_batch_positions", "mechanics_path_angle"),
            *("mechanics_load", "mechanics_friction", "mechanics_compression", "mechanics_validity"),
        ),
        without="mechanics/kernel",
    ),
    "studies": Area(
        ("studies",),
        (
            *("validation_division", "validation_score", "verdict", "paper", "validation_differences"),
            *("validation_coverage", "fit_warnings", "columnar", "planning", "credibility"),
            *("reporting_tables", "reporting_papers", "reporting_slicer", "cli_studies"),
            *("validation_run", "validation_heldout", "validation_forecast", "validation_validity"),
            *("validation_calibration", "validation_comparison", "validation_sensitivity"),
            *("validation_adaptation", "validation_seeds", "validation_synthetic_truth"),
            *("analysis_plan", "analysis_specimens", "analysis_next_insertion", "analysis_cohort"),
            *("cli_tracks", "cli_identify", "cli_material", "cli_reconstruct", "cli_verify", "every_kind"),
        ),
    ),
}

PRELOADED = ("numba", "numpy", "pydantic", "pytest", "scipy.interpolate", "scipy.ndimage", "scipy.optimize")
PRELOADED += ("scipy.spatial", "scipy.stats", "arviz", "emcee")

ARITHMETIC = {"Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow"}
IDENTITY = {"Is", "IsNot"}
LEFT_OUT = ("RemoveDecorator", "VariableReplacer", "VariableInserter", "NoOp")
MAX_CPU_FACTOR = 5
MIN_CPU_SECONDS = 10


@dataclass(frozen=True)
class Mutant:
    """One change: the `occurrence`-th of an operator in a module; its line `before` and `after`."""

    area: str
    module: str
    line: int
    operator: str
    occurrence: int
    before: str = ""
    after: str = ""
    outcome: str = ""
    seconds: float = 0.0


def is_sensible(operator: str) -> bool:
    """Whether the replacement can give another number instead of an error in every case."""
    if operator.startswith(LEFT_OUT):
        return False
    kind, *terms = operator.split("_")
    if kind == "ReplaceBinaryOperator":
        return len({term in ARITHMETIC for term in terms}) == 1
    if kind == "ReplaceComparisonOperator":
        return len({term in IDENTITY for term in terms}) == 1
    return True


def annotated_spans(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return where the annotations of a module begin and end."""
    nodes = [
        node
        for parent in ast.walk(ast.parse(source))
        for node in (getattr(parent, "annotation", None), getattr(parent, "returns", None))
        if isinstance(node, ast.expr)
    ]
    return [((n.lineno, n.col_offset), (n.end_lineno or 0, n.end_col_offset or 0)) for n in nodes]


def list_sites(project: Path, area: str) -> Iterator[list[Mutant]]:
    """Yield the places of an area that can be changed, each with all changes."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    package, without = project / "needlefit", AREAS[area].without
    roots = [package / name for name in AREAS[area].modules]
    files = sorted(file for root in roots for file in (root.rglob("*.py") if root.is_dir() else [root]))
    for file in files:
        if without and file.is_relative_to(package / without):
            continue
        source = file.read_text(encoding="utf-8")
        tree, spans, sites = get_ast(source), annotated_spans(source), defaultdict(list)
        for name in filter(lambda name: is_sensible(name.removeprefix("core/")), operator_names()):
            operator = get_operator(name)()
            positions = (found for node in ast_nodes(tree) for found in operator.mutation_positions(node))
            for occurrence, (start, end) in enumerate(positions):
                if not any(low <= start < high for low, high in spans):
                    module = str(file.relative_to(project))
                    sites[start, end].append(Mutant(area, module, start[0], name, occurrence))
        yield from (sites[place] for place in sorted(sites))


def draw_mutants(project: Path, area: str, count: int, seed: int) -> list[Mutant]:
    """Return `count` mutants of an area: places at random, one change of each."""
    rng, sites = random.Random(f"{seed} {area}"), list(list_sites(project, area))
    chosen = rng.sample(range(len(sites)), min(count, len(sites)))
    return [rng.choice(sites[number]) for number in sorted(chosen)]


class Copy:
    """A copy of the project, in which one module at a time is changed."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._written_at = folder, int(time.time())
        skipped = shutil.ignore_patterns(".*", "__pycache__", "_site", "*.partial")
        shutil.copytree(PROJECT, folder, ignore=skipped)

    @contextmanager
    def changed(self, mutant: Mutant) -> Iterator[tuple[str, str]]:
        """Change a module for a while; give its changed line, before and after."""
        from cosmic_ray.mutating import mutate_code
        from cosmic_ray.plugins import get_operator

        source = (self.folder / mutant.module).read_text(encoding="utf-8")
        changed = mutate_code(source, get_operator(mutant.operator)(), mutant.occurrence)
        if changed is None:
            raise SystemExit(f"{mutant.module} has no such place any more: {mutant.operator}")
        self._write(mutant.module, changed)
        try:
            pairs = zip(source.splitlines(), changed.splitlines(), strict=False)
            yield next(((a.strip(), b.strip()) for a, b in pairs if a != b), ("", ""))
        finally:
            self._write(mutant.module, source)

    def _write(self, module: str, source: str) -> None:
        """Write a module, each time at another second: bytecode is found again by it."""
        (self.folder / module).write_text(source, encoding="utf-8")
        self._written_at += 1
        os.utime(self.folder / module, (self._written_at, self._written_at))

    def run_tests(self, names: tuple[str, ...], cpu_seconds: int) -> tuple[str, float]:
        """Return the first test that fails ("" if none does), and the processor time."""
        report = self.folder.parent / "report.txt"
        child = os.fork()
        if not child:
            self._become_pytest(names, cpu_seconds, report)
        _, status, used = os.wait4(child, 0)
        text = report.read_text(encoding="utf-8", errors="replace")
        seconds = used.ru_utime + used.ru_stime
        if os.waitstatus_to_exitcode(status) == 0:
            return "", seconds
        failed = [line.split()[1] for line in text.splitlines() if line.startswith(("FAILED", "ERROR "))]
        stopped = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU
        return (failed or ["timeout" if stopped else "crash"])[0], seconds

    def _become_pytest(self, names: tuple[str, ...], cpu_seconds: int, report: Path) -> None:
        import pytest

        output = os.open(report, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds + 5))
        os.chdir(self.folder)
        sys.path.insert(0, str(self.folder))
        os.environ["PYTHONPATH"] = str(self.folder)
        files = [f"tests/test_{name}.py" for name in names]
        code = 1
        try:
            code = pytest.main(["-x", "-q", "-rfE", "-p", "no:cacheprovider", "--tb=no", *files])
        except BaseException:
            traceback.print_exc()
        finally:  # nothing of the parent is cleaned up here
            sys.stdout.flush()
            os._exit(code)


def run_area(copy: Copy, mutants: list[Mutant]) -> Iterator[Mutant]:
    """Yield the mutants of one area with what the tests made of them."""
    names = AREAS[mutants[0].area].tests
    failed, seconds = copy.run_tests(names, 10_000)
    if failed:
        raise SystemExit(f"{failed} fails on the code as it is")
    limit = max(MIN_CPU_SECONDS, round(MAX_CPU_FACTOR * seconds))
    for mutant in mutants:
        with copy.changed(mutant) as (before, after):
            failed, seconds = copy.run_tests(names, limit)
        outcome = failed or "survived"
        yield replace(mutant, before=before, after=after, outcome=outcome, seconds=round(seconds, 1))


def read_mutants(file: Path | None) -> list[Mutant]:
    """Return the mutants of an earlier run; none without a file."""
    if file is None or not file.exists():
        return []
    return [Mutant(**json.loads(line)) for line in file.read_text(encoding="utf-8").splitlines()]


def run_or_reuse(copy: Copy, mutants: list[Mutant], done: list[Mutant], out: Path | None) -> Iterator[Mutant]:
    """Yield mutants with their outcomes: those that are done as they are, then the others, kept in `out`."""
    known = {(one.module, one.operator, one.occurrence): one for one in done}
    left = [one for one in mutants if (one.module, one.operator, one.occurrence) not in known]
    yield from (known[one.module, one.operator, one.occurrence] for one in mutants if one not in left)
    for mutant in run_area(copy, left) if left else ():
        if out:
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(mutant)) + "\n")
        yield mutant


def read_options() -> argparse.Namespace:
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("area", nargs="*", metavar="AREA", help=f"of {', '.join(AREAS)}; all without")
    parser.add_argument("--mutants", type=int, default=26, help="of each area")
    parser.add_argument("--seed", type=int, default=17)
    parser.add_argument("--out", type=Path, help="a line of JSON per mutant; what is there is not run again")
    parser.add_argument("--again", action="store_true", help="run the survivors of --out again")
    return parser.parse_args()


def tabulate(found: list[Mutant]) -> list[list[str]]:
    """Return a table with a row for each area and for all."""
    counts = Counter((one.area, one.outcome == "survived") for one in found)
    pairs = {
        area: (counts[area, False], counts[area, True]) for area in dict.fromkeys(one.area for one in found)
    }
    pairs["all"] = (sum(killed for killed, _ in pairs.values()), sum(left for _, left in pairs.values()))
    rows = [[area, str(killed + left), str(killed), str(left)] for area, (killed, left) in pairs.items()]
    return [["area", "mutants", "killed", "survived"], *rows]


def main() -> None:
    """Run the mutants, print survivors as they come, and a table at the end."""
    options, found = read_options(), list[Mutant]()
    # as in needlefit.project.threads, which must not be imported: each fork imports the changed package
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))
    for name in PRELOADED:
        __import__(name)
    done = [one for one in read_mutants(options.out) if not (options.again and one.outcome == "survived")]
    with tempfile.TemporaryDirectory(prefix="needlefit-mutation-") as folder:
        copy = Copy(Path(folder) / "needlefit")
        for area in options.area or AREAS:
            mutants = draw_mutants(copy.folder, area, options.mutants, options.seed)
            for mutant in run_or_reuse(copy, mutants, done, options.out):
                found.append(mutant)
                if mutant.outcome == "survived":
                    print(f"{mutant.module}:{mutant.line}", flush=True)
                    print(f"  - {mutant.before}\n  + {mutant.after}", flush=True)
    rows = tabulate(found)
    print("\n".join("  ".join(cell.ljust(12) for cell in row) for row in rows))


if __name__ == "__main__":
    main()
