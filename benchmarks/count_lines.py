"""Lines of sources and words of documents beside their budgets, by package and in all.

    python benchmarks/count_lines.py

`now` is the budget of this step, `later` the one of the next. Of Python, code, docstrings, imports, comments
and blank lines are stated apart, and the size of functions.
Lines are those of the files as they are; `ruff format` keeps Python's at 110 characters.
"""

import ast
import subprocess
import tokenize
from collections import Counter
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
SOURCES = {".py", ".js", ".mjs", ".css", ".html", ".cpp", ".hpp", ".j2", ".typ"}
TABLES = {"needlefit/reporting/columns.csv"}
PACKAGES = {
    "cli": 2500, "datasets": 5000, "geometry, metrics": 1400, "imaging": 8300, "inference": 7800,
    "mechanics": 9000, "planning": 900, "project": 2600, "reporting": 6000, "schemas": 1700, "studies": 9500,
    "synthetic": 1600, "viewer": 8000,
}  # fmt: skip
"""Lines of each package of needlefit, at most; modules beside the packages have no budget of their own."""
BUDGETS = {"needlefit": (70_000, 65_000), "tests": (30_000, 26_000), "benchmarks": (4500, 4500)}
WORDS = (25_000, 24_000)
"""Budgets of lines, and of the documents' words: now and later."""


def list_files(*folders):
    """Return the files of folders that git knows or would add, as paths from the root."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *folders]
    found = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return sorted({name for name in found.splitlines() if (ROOT / name).is_file()})


def is_source(name):
    """Return whether the lines of a file count; those of others that are kept unchanged do not."""
    return (Path(name).suffix in SOURCES or name in TABLES) and "/vendor" not in name


def count_lines(name):
    """Return the number of lines of a file."""
    return len((ROOT / name).read_text(encoding="utf-8").splitlines())


def list_lines(node):
    """Return the line numbers that a node spans."""
    return set(range(node.lineno, node.end_lineno + 1))


def describe_python(name):
    """Return the lines of a Python file by what they hold, and the lines of each of its functions."""
    text = (ROOT / name).read_text(encoding="utf-8")
    tree, lines = ast.parse(text), text.splitlines()
    docstrings, imports, functions = set(), set(), []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            functions.append(len(list_lines(node)))
        if isinstance(node, ast.Import | ast.ImportFrom):
            imports |= list_lines(node)
        body = getattr(node, "body", None)
        for one in body if isinstance(body, list) else ():
            if (
                isinstance(one, ast.Expr)
                and isinstance(one.value, ast.Constant)
                and isinstance(one.value.value, str)
            ):
                docstrings |= list_lines(one)
    with (ROOT / name).open("rb") as stream:
        comments = {
            token.start[0]
            for token in tokenize.tokenize(stream.readline)
            if token.type == tokenize.COMMENT and token.line.lstrip().startswith("#")
        }
    blank = {n for n, line in enumerate(lines, 1) if not line.strip()} - docstrings
    kinds = {"docstrings": docstrings, "imports": imports, "comments": comments, "blank": blank}
    found = Counter({kind: len(numbers) for kind, numbers in kinds.items()})
    found["code"] = len(lines) - found.total()
    return found, functions


def describe(names):
    """Print the lines of Python files by what they hold, and the size of their functions."""
    parts, functions = Counter(), []
    for name in names:
        if name.endswith(".py"):
            found, lengths = describe_python(name)
            parts += found
            functions += lengths
    kinds = ("code", "docstrings", "imports", "comments", "blank")
    median, ninetieth = np.percentile(functions, (50, 90))
    print(f"    of Python {parts.total()}: {', '.join(f'{kind} {parts[kind]}' for kind in kinds)}")
    print(f"    {len(functions)} functions, lines: median {median:.0f}, 90th percentile {ninetieth:.0f}")


def print_row(label, count, *budgets):
    """Print what stands, its budgets, and by how much it is over the first of them."""
    over = max(0, count - budgets[0]) if budgets else 0
    shown = "".join(f"{number:>9}" for number in (count, *budgets))
    print(f"{label:20}{shown:36}{over or '':>9}".rstrip())


def main():
    """Print the table, by package and in all, and what the lines of Python hold."""
    sources = {part: list(filter(is_source, list_files(part))) for part in BUDGETS}
    lines = {name: count_lines(name) for names in sources.values() for name in names}
    print(f"{'package':20}{'lines':>9}{'at most':>9}{'over':>27}")
    known = []
    for label, budget in PACKAGES.items():
        folders = tuple(f"needlefit/{folder}/" for folder in label.split(", "))
        known += [name for name in sources["needlefit"] if name.startswith(folders)]
        print_row(label, sum(lines[name] for name in known if name.startswith(folders)), budget)
    others = set(sources["needlefit"]) - set(known)
    print_row("other modules", sum(lines[name] for name in others))
    print_row("sum of the budgets", sum(lines[name] for name in known), sum(PACKAGES.values()))
    print(f"\n{'':20}{'lines':>9}{'now':>9}{'later':>9}{'over now':>18}")
    for part, names in sources.items():
        print_row(part, sum(lines[name] for name in names), *BUDGETS[part])
    documents = [name for name in list_files() if name.endswith(".md") and not name.startswith("reports/")]
    words = sum(len((ROOT / name).read_text(encoding="utf-8").split()) for name in documents)
    print_row("documents, words", words, *WORDS)
    for part, names in sources.items():
        print(f"\n{part}: {len(names)} files")
        describe(names)


if __name__ == "__main__":
    main()
