"""The documentation's links lead somewhere, its commands exist, and what it shows is held against them."""

import re
import subprocess
import sys

import pytest
from docs_scripts import load_script

from needlefit.cli.application import build
from needlefit.project.locate import shipped_folder

DOCS = shipped_folder() / "docs"
pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="not run from the repository")
README = DOCS.parent / "README.md"
PAGES = [
    README,
    *sorted(DOCS.glob("*.md")),
    *sorted(DOCS.glob("*/*.md")),
    *sorted(DOCS.glob("../*/README.md")),
]
TEXT = README.read_text("utf-8") if README.is_file() else ""
EXAMPLES = re.findall(r"```python\n(.*?)```\s*```text\n(.*?)```", TEXT, re.DOTALL)


@pytest.fixture(scope="module")
def transcripts():
    return load_script(DOCS / "transcripts.py")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    """The places within pages, which `sphinx-build -n` follows, are left out."""
    links = re.findall(r"\]\(([^)\s#]+)[^)]*\)", page.read_text("utf-8"))
    assert [link for link in links if ":" not in link and not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_their_options_exist(page, known):
    for line in re.findall(
        r"(?:^(?:\$ |    )|`)needlefit ([a-z][^`\n|>#;]*)", page.read_text("utf-8"), re.MULTILINE
    ):
        words = line.split()
        named = next(name for name in (" ".join(words[:2]), words[0], "") if name in known)
        assert named, line
        assert {word.partition("=")[0] for word in words if word.startswith("--")} <= known[named], line


@pytest.fixture(scope="module")
def known():
    import typer

    found = {"": set()}

    def walk(command, name):
        if hasattr(command, "commands"):
            for word, inner in command.commands.items():
                walk(inner, f"{name} {word}".strip())
        else:
            found[name] = {option for parameter in command.params for option in parameter.opts} | {"--help"}

    walk(typer.main.get_command(build()), "")
    return found


def test_the_commands_of_a_guide_print_what_it_shows(transcripts):
    assert transcripts.check(DOCS / "guides/slicer.md")


def test_a_notebook_runs():
    pytest.importorskip("nbclient")
    words = [sys.executable, DOCS / "notebooks.py", DOCS / "notebooks/3_simulate.ipynb"]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)


def test_the_examples_of_the_readme_print_the_output_below_them(capsys):
    assert EXAMPLES
    for code, prints in EXAMPLES:
        exec(compile(code, str(README), "exec"), {})
        assert capsys.readouterr().out == prints


def test_the_results_of_the_readme_are_the_stored_ones():
    assert load_script(DOCS / "readme_results.py").write_page() == TEXT, "run `python docs/readme_results.py`"
