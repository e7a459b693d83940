"""Write an IEEEtran document that inputs the LaTeX files of a run."""

from collections.abc import Sequence
from pathlib import Path

from needlefit.reporting.document import Block, Document, is_half_width
from needlefit.reporting.latex import escape_latex

EXAMPLE_FILE = "example.tex"

_HEAD = r"""% An example of a paper that uses the files of this folder. Written by needlefit.
% Compile: latexmk -pdf example.tex
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
