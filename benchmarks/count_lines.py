"""Lines of sources and words of documents beside their budgets, by package and in all.

    python benchmarks/count_lines.py

Lines are those of the files as they are; `ruff format` keeps Python's at 110 characters.
"""

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCES = {".py", ".js", ".mjs", ".css", ".html", ".cpp", ".hpp", ".j2", ".typ"}
TABLES = {"needlefit/reporting/columns.csv"}
BUILT = {"needlefit/reporting/needle_page.js"}  # of other sources, which count
PACKAGES = {
    "cli": 2500, "datasets": 5000, "geometry, metrics": 1400, "imaging": 8300, "inference": 7800,
    "mechanics": 9000, "planning": 900, "project": 2600, "reporting": 6000, "schemas": 1700, "studies": 9500,
    "synthetic": 1600, "viewer": 8000,
}  # fmt: skip
"""Lines of each package of needlefit, at most; modules beside the packages have no budget of their own."""
BUDGETS = {"needlefit": 65_000, "tests": 26_000, "benchmarks": 4500}
WORDS = 24_000
"""Budgets of lines, and of the documents' words."""


def list_files(*folders):
    """Return the files of folders that git knows or would add, as paths from the root."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *folders]
    found = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return sorted({name for name in found.splitlines() if (ROOT / name).is_file()})


def is_source(name):
    """Return whether the lines of a file count; those of others that are kept unchanged do not."""
    listed = Path(name).suffix in SOURCES or name in TABLES
    return listed and name not in BUILT and "/vendor" not in name


def count_lines(name):
    """Return the number of lines of a file."""
    return len((ROOT / name).read_text(encoding="utf-8").splitlines())


def print_row(label, count, budget=None):
    """Print what stands, its budget, and by how much it is over."""
    over = "" if budget is None else max(0, count - budget) or ""
    print(f"{label:20}{count:>9}{budget or '':>9}{over:>9}".rstrip())


def main():
    """Print the table, by package and in all."""
    sources = {part: list(filter(is_source, list_files(part))) for part in BUDGETS}
    lines = {name: count_lines(name) for names in sources.values() for name in names}
    print(f"{'lines':20}{'now':>9}{'at most':>9}{'over':>9}")
    others = set(sources["needlefit"])
    for label, budget in PACKAGES.items():
        folders = tuple(f"needlefit/{folder}/" for folder in label.split(", "))
        own = {name for name in others if name.startswith(folders)}
        print_row(f"  {label}", sum(lines[name] for name in own), budget)
        others -= own
    print_row("  other modules", sum(lines[name] for name in others))
    for part, names in sources.items():
        print_row(part, sum(lines[name] for name in names), BUDGETS[part])
    documents = [name for name in list_files() if name.endswith(".md")]
    words = sum(len((ROOT / name).read_text(encoding="utf-8").split()) for name in documents)
    print_row("documents, words", words, WORDS)


if __name__ == "__main__":
    main()
