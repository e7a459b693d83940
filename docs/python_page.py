"""Run the Python of docs/python.md, compare what it prints with the page, and keep its picture.

    python docs/python_page.py    exit code 1 if the output differs; writes docs/figures/corner.png

The `pycon` blocks of the page are one session, in the folder in which its `console` blocks ran.
Numbers may differ as in transcripts.py.
"""

import doctest
import re
import shutil
import sys
import tempfile
from contextlib import chdir
from pathlib import Path

import matplotlib as mpl
import transcripts

HERE = Path(__file__).resolve().parent
PAGE, PICTURE = HERE / "python.md", "corner.png"
OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


class Checker(doctest.OutputChecker):
    """Compare output as `transcripts.agrees` does, or as doctest."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        """Whether both are one, but for the last digits of numbers."""
        agrees = transcripts.agrees(*([line.strip() for line in text.splitlines()] for text in (want, got)))
        return agrees or super().check_output(want, got, optionflags)


def run_page(folder: Path) -> doctest.TestResults:
    """Run the page in an empty folder; print what differs."""
    text = PAGE.read_text("utf-8")
    transcripts.run_page(text, str(folder))
    blocks = re.findall(r"```pycon\n(.*?)```", text, re.DOTALL)
    page = doctest.DocTestParser().get_doctest("".join(blocks), {}, PAGE.name, str(PAGE), 0)
    with chdir(folder), mpl.rc_context({"backend": "agg"}):
        return doctest.DocTestRunner(Checker(), optionflags=OPTIONS).run(page)


def main() -> int:
    """Run the page, and keep its picture; return 0 if its output is what it shows."""
    with tempfile.TemporaryDirectory() as folder:
        found = run_page(Path(folder))
        shutil.copyfile(Path(folder, PICTURE), HERE / "figures" / PICTURE)
    print(f"{found.attempted} examples, {found.failed} differ")
    return int(found.failed > 0)


if __name__ == "__main__":
    sys.exit(main())
