"""Mutation testing: whether the tests notice when the code is changed.

    python -m pip install cosmic-ray "tree-sitter-cpp[core]"
    python benchmarks/mutation.py [AREA ...] [--mutants 26] [--seed 17] [--out FILE [--again]]

In each area so many places are drawn at random, and of each place one of the changes that cosmic-ray knows:
another operator, number or comparison, a condition negated, a loop left out. Those of C++ (`native`) are in
`cpp_changes.py`. Each is made alone in a copy of the project, and the area's tests run on it until one fails.
A mutant that no test notices has survived. With --out an interrupted run goes on.

Changes of annotations and decorators are left out, and replacements that fail on every number (`a << b`
for `a * b`). Of C++, what does not compile or compiles to the same library is left out, and counted.

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
NATIVE = "mechanics/native"


@dataclass(frozen=True)
class Area:
    """Modules that are mutated (files or folders below `needlefit`), and the test files that run on them."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    cpp: bool = False


MECHANICS = tuple(
    sorted(
        file.stem.removeprefix("test_")
        for pattern in ("mechanics_*", "native*")
        for file in (PROJECT / "tests").glob(f"test_{pattern}.py")
    )
)
"""The tests of the model, in Python and in C++."""

AREAS = {
    "likelihood": Area(
        ("inference/likelihood", "inference/problem.py"),
        (
            *("inference_likelihood", "inference_tracks"),
            *("inference_marginal", "inference_document", "inference_golden"),
        ),
    ),
    "sampling": Area(
        ("inference/sampling/posterior.py", "inference/sampling/sample.py"),
        ("inference_sample",),
    ),
    "importance": Area(
        (
            "inference/sampling/importance.py",
            "inference/sampling/pareto_smoothing.py",
            "inference/sampling/student_mixture.py",
        ),
        ("inference_importance", "inference_specimens", "inference_golden"),
    ),
    "errors": Area(
        ("inference/error_fit.py",),
        ("inference_error_fit",),
    ),
    "held": Area(("inference/draws.py", "inference/prior_shift.py"), ("inference_held",)),
    "judge": Area(("studies/judge.py",), ("judge",)),
    "parameters": Area(
        ("inference/parameters.py", "inference/prior.py", "inference/parameter_changes.py"),
        (
            *("inference_parameters", "inference_prior", "inference_parameter_changes"),
            *("inference_problem", "inference_optimize"),
        ),
    ),
    "specimens": Area(
        ("inference/specimens.py",), ("inference_specimens", "validation_heldout", "validation_forecast")
    ),
    "predictions": Area(
        (
            "inference/predictive_mixture.py",
            "inference/point_prediction.py",
            "inference/later_readings.py",
            "inference/likelihood/observations/tip_track.py",
        ),
        (
            *("inference_predict", "point_predictions", "inference_tracks", "inference_space"),
            "validation_heldout",
        ),
    ),
    "bands": Area(
        ("inference/curve_bands.py", "inference/ecdf_band.py"),
        ("validation_forecast", "ecdf_band"),
    ),
    "coverage": Area(
        ("studies/prediction_scores.py", "studies/scored_groups.py"),
        ("validation_heldout", "inference_space", "judge", "reporting_tables"),
    ),
    "planes": Area(
        ("datasets/compared.py", "datasets/planes.py"),
        ("dataset_warnings", "inference_space", "outliers", "datasets"),
    ),
    "outliers": Area(
        ("datasets/outlying_points.py", "datasets/scatter.py", "geometry/neighbours.py"),
        ("outliers", "dataset_warnings"),
    ),
    "lengths": Area(
        ("geometry/measured_curve.py", "geometry/penalized_spline.py"),
        ("measured_curve", "dataset_warnings", "datasets", "outliers"),
    ),
    "surfaces": Area(
        ("geometry/crossings.py", "geometry/surfaces.py"),
        ("geometry_crossings", "datasets", "imaging_layers"),
    ),
    "planning": Area(("planning/goals.py", "planning/steering.py"), ("planning",)),
    "markers": Area(("imaging/spheres.py", "imaging/point_spread.py"), ("imaging_markers",)),
    "metrics": Area(
        ("metrics", "geometry/curves.py"), ("inference_problem", "plugins", "geometry", "reporting_tables")
    ),
    "registration": Area(
        ("imaging/registration.py", "geometry/frames.py"),
        ("geometry", "imaging_registration", "imaging_golden"),
    ),
    "resume": Area(
        ("project/checkpoint.py", "project/folders.py"),
        ("project_checkpoint",),
    ),
    "mechanics": Area(("mechanics",), MECHANICS),
    "native": Area((NATIVE,), MECHANICS, cpp=True),
    "studies": Area(
        ("studies", "planning"),
        (
            *("validation_run", "validation_heldout", "validation_forecast", "simulated_data"),
            *("validation_differences", "fit_warnings", "planning"),
            *("reference", "reporting_tables", "reporting_files", "reporting_slicer"),
            *(
                "cli_studies",
                "cli_tracks",
                "cli_analyses",
                "cli_reconstruct",
                "every_kind",
            ),
        ),
    ),
}

PRELOADED = ("numpy", "pydantic", "pytest", "scipy.interpolate", "scipy.ndimage", "scipy.optimize")
PRELOADED += ("scipy.spatial", "scipy.stats", "arviz", "emcee")

ARITHMETIC = {"Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow"}
IDENTITY = {"Is", "IsNot"}
LEFT_OUT = ("RemoveDecorator", "VariableReplacer", "VariableInserter", "NoOp")
MAX_CPU_FACTOR = 5
MIN_CPU_SECONDS = 10
NOT_COMPILED, SAME_LIBRARY = "not compiled", "same library"


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


def change_code(source: str, mutant: Mutant) -> str | None:
    """Return the code of a module with the mutant's change; None if there is no such place."""
    if AREAS[mutant.area].cpp:
        from cpp_changes import apply_change

        return apply_change(source, mutant.operator, mutant.occurrence)
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    changed: str | None = mutate_code(source, get_operator(mutant.operator)(), mutant.occurrence)
    return changed


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
    package, cpp = project / "needlefit", AREAS[area].cpp
    roots, suffix = [package / name for name in AREAS[area].modules], "*.[ch]pp" if cpp else "*.py"
    files = sorted(file for root in roots for file in (root.rglob(suffix) if root.is_dir() else [root]))
    for file in files:
        source, module = file.read_text(encoding="utf-8"), str(file.relative_to(project))
        yield from _list_cpp_sites(source, area, module) if cpp else _list_python_sites(source, area, module)


def _list_cpp_sites(source: str, area: str, module: str) -> Iterator[list[Mutant]]:
    from cpp_changes import list_changes

    if module.endswith("processor.hpp"):  # it chooses among libraries, and here there is one
        return
    counts = Counter[str]()
    for place in list_changes(source):
        line = source.encode()[: place[0][1]].count(b"\n") + 1
        yield [Mutant(area, module, line, name, counts[name]) for name, *_ in place]
        counts.update(name for name, *_ in place)


def _list_python_sites(source: str, area: str, module: str) -> Iterator[list[Mutant]]:
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    tree, spans, sites = get_ast(source), annotated_spans(source), defaultdict(list)
    for name in filter(lambda name: is_sensible(name.removeprefix("core/")), operator_names()):
        operator = get_operator(name)()
        positions = (found for node in ast_nodes(tree) for found in operator.mutation_positions(node))
        for occurrence, (start, end) in enumerate(positions):
            if not any(low <= start < high for low, high in spans):
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
        source = (self.folder / mutant.module).read_text(encoding="utf-8")
        changed = change_code(source, mutant)
        if changed is None:
            raise SystemExit(f"{mutant.module} has no such place any more: {mutant.operator}")
        self._write(mutant.module, changed)
        try:
            pairs = zip(source.splitlines(), changed.splitlines(), strict=False)
            yield next(((a.strip(), b.strip()) for a, b in pairs if a != b), ("", ""))
        finally:
            self._write(mutant.module, source)

    def build(self, name: str) -> Path | None:
        """Compile the C++ kernel as it stands; return its library, None if it does not compile."""
        from cpp_changes import build_library

        library = self.folder.parent / name
        return library if build_library(self.folder / "needlefit" / NATIVE, library) else None

    def _write(self, module: str, source: str) -> None:
        """Write a module, each time at another second: bytecode is found again by it."""
        (self.folder / module).write_text(source, encoding="utf-8")
        self._written_at += 1
        os.utime(self.folder / module, (self._written_at, self._written_at))

    def run_tests(
        self, names: tuple[str, ...], cpu_seconds: int, library: Path | None = None
    ) -> tuple[str, float]:
        """Return the first test that fails ("" if none does), and the processor time.

        `library`: of the kernel; by default the package's own.
        """
        report = self.folder.parent / "report.txt"
        child = os.fork()
        if not child:
            if library:
                os.environ["NEEDLEFIT_LIBRARY"] = str(library)
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
    area = AREAS[mutants[0].area]
    unchanged = copy.build("unchanged.so") if area.cpp else None
    failed, seconds = copy.run_tests(area.tests, 10_000, unchanged)
    if failed:
        raise SystemExit(f"{failed} fails on the code as it is")
    limit = max(MIN_CPU_SECONDS, round(MAX_CPU_FACTOR * seconds))
    for mutant in mutants:
        with copy.changed(mutant) as (before, after):
            library = copy.build("changed.so") if unchanged else None
            if unchanged and not library:
                failed, seconds = NOT_COMPILED, 0.0
            elif unchanged and library and library.read_bytes() == unchanged.read_bytes():
                failed, seconds = SAME_LIBRARY, 0.0
            else:
                failed, seconds = copy.run_tests(area.tests, limit, library)
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
    kinds = {"survived": "survived", NOT_COMPILED: "left out", SAME_LIBRARY: "left out"}
    counts = Counter((area, kinds.get(one.outcome, "killed")) for one in found for area in (one.area, "all"))
    columns = ("killed", "survived", "left out")
    areas = [*dict.fromkeys(one.area for one in found), "all"]
    return [["area", *columns], *([area, *(str(counts[area, name]) for name in columns)] for area in areas)]


def main() -> None:
    """Run the mutants, print survivors as they come, and a table at the end."""
    options, found = read_options(), list[Mutant]()
    # as in needlefit.project.processes, which must not be imported: each fork imports the changed package
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
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
