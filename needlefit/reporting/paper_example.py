"""Write an IEEEtran document that inputs the LaTeX files of a run, and compile it."""

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.reporting.document import Block, Document, is_half_width
from needlefit.reporting.latex import escape_latex

EXAMPLE_FILE = "example.tex"
MAX_COMPILE_S = 300

_HEAD = r"""% An example of a paper that uses the files of this folder. Written by needlefit.
% Compile: needlefit report RUN --latex example.pdf, or latexmk -pdf example.tex
\documentclass[journal]{IEEEtran}
\usepackage[T1]{fontenc}
\usepackage{textcomp,booktabs,graphicx,siunitx,url}
\input{numbers}
\begin{document}
"""


def format_example(report: Document, figures: Sequence[Block], tables: Sequence[str], methods: bool) -> str:
    """Return the document: methods, every table by the name of its file, every figure with its caption."""
    parts = [_HEAD, f"\\title{{{escape_latex(report.title)}}}\n\\author{{}}\n\\maketitle\n"]
    parts += ["\\section{Methods}\n\\input{methods}\n"] if methods else []
    parts += ["\\section{Results}\n", *(f"\\input{{{name}}}\n" for name in tables)]
    origin = "SYNTHETIC DATA. " if report.synthetic else ""
    parts += [_format_figure(block, origin) for block in figures]
    parts += ["\\clearpage\n"]  # or LaTeX keeps too many figures waiting
    parts += ["\\bibliographystyle{IEEEtran}\n\\bibliography{references}\n"] if methods else []
    return "".join([*parts, "\\end{document}\n"])


def _format_figure(block: Block, origin: str) -> str:
    """Return a figure in its own width: larger or smaller, its letters would not be 8 points high."""
    environment = "figure" if is_half_width(block["path"]) else "figure*"
    name = Path(block["path"]).stem
    return (
        f"\\begin{{{environment}}}\n\\centering\n"
        f"\\includegraphics{{{name}}}\n"
        f"\\caption{{{escape_latex(origin + block['caption'])}}}\n"
        f"\\label{{fig:{name}}}\n\\end{{{environment}}}\n"
    )


def compile_example(folder: Path, target: Path) -> None:
    """Compile the example document of a result folder to the PDF `target`.

    ConfigError if LaTeX is not installed, the folder has no example, or LaTeX reports an error.
    """
    if shutil.which("pdflatex") is None or shutil.which("bibtex") is None:
        raise ConfigError(
            "LaTeX is not installed", expected="pdflatex and bibtex on PATH", fix="install TeX Live"
        )
    if not (folder / EXAMPLE_FILE).is_file():
        raise ConfigError(
            f"holds no {EXAMPLE_FILE}", where=str(folder), fix=f"write it: needlefit report {folder.name}"
        )
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        for path in folder.iterdir():
            if path.suffix in (".tex", ".bib", ".pdf"):
                shutil.copyfile(path, Path(name) / path.name)
        stem = Path(EXAMPLE_FILE).stem
        _run_latex(["pdflatex", "-interaction=nonstopmode", "-halt-on-error", EXAMPLE_FILE], name)
        if (folder / "references.bib").is_file():
            _run_latex(["bibtex", stem], name)
        for _ in range(2):  # citations, then references to them
            _run_latex(["pdflatex", "-interaction=nonstopmode", "-halt-on-error", EXAMPLE_FILE], name)
        shutil.copyfile(Path(name) / f"{stem}.pdf", target)


def _run_latex(command: list[str], folder: str) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, timeout=MAX_COMPILE_S, check=False)
    if done.returncode:
        lines = done.stdout.decode("utf-8", "replace").splitlines()
        first = next((line for line in lines if line.startswith("!")), "no message")
        raise ConfigError(
            f"{command[0]} failed: {first}", where=EXAMPLE_FILE, fix="read its log, correct the file"
        )
