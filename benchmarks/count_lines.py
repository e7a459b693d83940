"""Count the lines of the package's and the tests' sources, and the words of the documents written by hand.

    python benchmarks/count_lines.py

Of Python, code, docstrings, imports, comments and blank lines are stated apart, and the size of functions.
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
STUDIES = ("needlefit/studies/", "needlefit/planning/")


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


def describe(label, names):
    """Print the lines of files: all, Python's by what they hold, and the size of its functions."""
    sources = [name for name in names if is_source(name)]
    parts, functions = Counter(), []
    for name in sources:
        if name.endswith(".py"):
            found, lengths = describe_python(name)
            parts += found
            functions += lengths
    share = ", ".join(
        f"{kind} {parts[kind]}" for kind in ("code", "docstrings", "imports", "comments", "blank")
    )
    median, ninetieth = np.percentile(functions, (50, 90)) if functions else (0, 0)
    print(f"{label}: {sum(map(count_lines, sources))} lines in {len(sources)} files")
    print(f"    of Python {parts.total()}: {share}")
    print(f"    {len(functions)} functions, lines: median {median:.0f}, 90th percentile {ninetieth:.0f}")


def main():
    """Print the size of the package, of its parts, of the tests and of the documents."""
    package, tests = list_files("needlefit"), list_files("tests")
    describe("needlefit", package)
    for part in sorted({name.split("/")[1] for name in package if name.count("/") > 1}):
        count = sum(
            count_lines(name) for name in package if is_source(name) and name.startswith(f"needlefit/{part}/")
        )
        print(f"    {count:6d}  {part}")
    describe("studies with planning", [name for name in package if name.startswith(STUDIES)])
    describe("tests", tests)
    describe("benchmarks", list_files("benchmarks"))
    documents = [name for name in list_files() if name.endswith(".md") and not name.startswith("reports/")]
    words = sum(len((ROOT / name).read_text(encoding="utf-8").split()) for name in documents)
    print(f"documents: {words} words in {len(documents)} files")


if __name__ == "__main__":
    main()
