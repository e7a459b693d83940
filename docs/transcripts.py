"""Run the commands shown on the pages, and compare their output with the pages.

    python docs/transcripts.py [PAGE ...]            ends with exit code 1 if the output differs
    python docs/transcripts.py [PAGE ...] --write    writes the present output and pictures into the pages

The `console` blocks of a page are one session in an empty folder. `$ ` begins a command, `> ` continues
it, and its output follows; `...` marks lines left out. A number with decimals may differ by one
in its last digit, or by 3 %: so do intervals of random draws from processor to processor.
A picture whose caption begins with a file of the session, *`FILE`, is that file.
"""

import argparse
import difflib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import typst

HERE = Path(__file__).resolve().parent
PAGES = [HERE / "start.md", *sorted((HERE / "guides").glob("*.md"))]
BLOCK = re.compile(r"(?<=^```console\n).*?(?=^```$)", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"^!\[[^]]*\]\((.+\.png)\)\n\n\*`(.+?)`", re.MULTILINE)
PIXELS_PER_INCH = 200
NUMBER = re.compile(r"\d+(?:\.(\d+))?")
LEFT_OUT = "..."
DRAW_ERROR = 0.03
"""By which part of itself an end of an interval differs from processor to processor."""

Run = Callable[[str], list[str]]


def main() -> int:
    """Check the pages named on the command line; return 0 if the output of all their commands agrees."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="*", type=Path, default=PAGES)
    parser.add_argument("--write", action="store_true", help="write the present output into the pages")
    options = parser.parse_args()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        agreeing = list(pool.map(partial(check, write=options.write), options.pages))
    return 0 if all(agreeing) else 1


def check(page: Path, *, write: bool = False) -> bool:
    """Whether the commands of a page print what it shows; prints the differences."""
    text = page.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        now = run_page(text, folder)
        for picture, file in PICTURE.findall(text) if write else ():
            save_picture(Path(folder, file), page.parent / picture)
    if write:
        page.write_text(now, encoding="utf-8")
    lines = (version.splitlines(keepends=True) for version in (text, now))
    difference = "".join(difflib.unified_diff(*lines, f"{page.name}, as it is", f"{page.name}, as run"))
    verdict = "the output of its commands differs" if difference else "agrees with its commands"
    print(f"{difference}{page.name}: {verdict}", flush=True)
    return not difference


def run_page(text: str, folder: str) -> str:
    """Run the commands of a page in a folder; return the page with their present output."""
    return BLOCK.sub(lambda block: renewed(block[0], partial(run, folder)), text)


def save_picture(file: Path, picture: Path) -> None:
    """Save a figure (.png or .pdf) as a PNG."""
    if file.suffix == ".png":
        shutil.copyfile(file, picture)
        return
    sheet = file.with_suffix(".typ")
    sheet.write_text(f'#set page(width: auto, height: auto, margin: 2mm)\n#image("{file.name}")\n', "utf-8")
    typst.compile(sheet, output=picture, ppi=PIXELS_PER_INCH)


def renewed(block: str, run: Run) -> str:
    """Return a block with the present output of its commands, wherever it differs."""
    text = ""
    for command, typed, shown in commands(block):
        printed = run(command)
        kept = shown if agrees(shown, printed) else excerpt(shown, printed)
        text += typed + "".join(f"{line}\n" for line in kept)
    return text


def commands(block: str) -> Iterator[tuple[str, str, list[str]]]:
    """Yield each command of a block, the lines in which it was typed, and the lines shown below it."""
    for part in re.split(r"^(?=\$ )", block, flags=re.MULTILINE)[1:]:
        lines = part.splitlines()
        count = 1 + next((n for n, line in enumerate(lines[1:]) if not re.match("> ?", line)), len(lines) - 1)
        words = [lines[0][2:], *(line[2:] for line in lines[1:count])]
        yield "\n".join(words), "".join(f"{line}\n" for line in lines[:count]), lines[count:]


def run(folder: str, command: str) -> list[str]:
    """Return the lines that a command prints in a folder, and its exit code if that is not 0."""
    here = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": here, "NO_COLOR": "1"}
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, env=environment, text=True, check=False,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    lines = [line.rstrip() for line in done.stdout.rstrip().splitlines()]
    return [*lines, f"[exit code {done.returncode}]"] if done.returncode else lines


def agrees(shown: list[str], printed: list[str]) -> bool:
    """Whether lines agree with the output, except for lines left out."""
    if not shown:
        return not printed
    if shown[0] == LEFT_OUT:
        return any(agrees(shown[1:], printed[start:]) for start in range(len(printed) + 1))
    return bool(printed) and same(shown[0], printed[0]) and agrees(shown[1:], printed[1:])


def same(shown: str, printed: str) -> bool:
    """Whether two lines are one, but for spaces, rules and the last digits of numbers."""
    words = [NUMBER.sub("#", re.sub(r"[\s─]+", " ", line)) for line in (shown, printed)]
    return words[0] == words[1] and all(map(close, NUMBER.finditer(shown), NUMBER.finditer(printed)))


def close(shown: re.Match[str], printed: re.Match[str]) -> bool:
    """Whether two numbers with decimals differ by no more than machines do; whole ones not at all."""
    allowed = max(1.001 * 10.0 ** -len(shown[1]), DRAW_ERROR * float(shown[0])) if shown[1] else 0.0
    return abs(float(shown[0]) - float(printed[0])) <= allowed


def excerpt(shown: list[str], printed: list[str]) -> list[str]:
    """Return what was printed, without the lines that most resemble those left out so far."""
    if LEFT_OUT not in shown:
        return printed
    lines, position = list[str](), 0
    for part in re.split(r"^\.\.\.\n", "".join(f"{line}\n" for line in shown), flags=re.MULTILINE):
        if kept := part.splitlines():
            first = position + nearest(kept[0], printed[position:])
            last = first + nearest(kept[-1], printed[first:])
            kept, position = printed[first : last + 1], last + 1
        lines += [*kept, LEFT_OUT]
    return lines[:-1]


def nearest(line: str, printed: list[str]) -> int:
    """Return the number of the line that most resembles one."""
    likeness = [difflib.SequenceMatcher(None, line, other).ratio() for other in printed]
    return max(range(len(printed)), key=likeness.__getitem__, default=0)


if __name__ == "__main__":
    sys.exit(main())
