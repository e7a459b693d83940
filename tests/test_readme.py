"""The README's commands and example do what it says."""

import re
import shlex

import pytest
from docs_scripts import load_script

from needlefit.cli.application import build
from needlefit.project.locate import shipped_folder

README = shipped_folder() / "README.md"
pytestmark = pytest.mark.skipif(not README.is_file(), reason="not run from the repository")
TEXT = README.read_text(encoding="utf-8") if README.is_file() else ""


def block(after: str) -> str:
    found = re.search(re.escape(after) + r"\n```\w*\n(.*?)```", TEXT, re.DOTALL)
    assert found, f"README.md has no block after {after}"
    return found[1].strip()


EXAMPLES = re.findall(r"```python\n(.*?)```\s*```text\n(.*?)```", TEXT, re.DOTALL)


@pytest.mark.parametrize(("code", "prints"), EXAMPLES)
def test_a_python_example_prints_the_output_below_it(code, prints, capsys):
    exec(compile(code, str(README), "exec"), {})
    assert capsys.readouterr().out == prints


def test_there_are_python_examples():
    assert EXAMPLES


def test_every_command_exists():
    import typer

    app = typer.main.get_command(build())
    lines = re.findall(r"`needlefit ([^`]+)`", TEXT)
    assert len(lines) > 8
    for line in lines:
        words = shlex.split(line)
        command = app
        while getattr(command, "commands", None) and words and not words[0].startswith("-"):
            if words[0].isupper():  # COMMAND, a placeholder
                break
            assert words[0] in command.commands, line
            command = command.commands[words.pop(0)]
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        assert {word for word in words if word.startswith("--")} <= known, line


def test_one_command_runs_everything_and_one_runs_the_tests():
    run, test = block("<!-- command:run -->"), block("<!-- command:test -->")
    assert "\n" not in run and "\n" not in test
    assert run.startswith("python3 -m venv") and run.endswith("needlefit validate all")
    assert test.startswith("python3 -m venv") and " -m pytest " in test


def test_every_named_file_exists():
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", TEXT) if not link.startswith("http")]
    assert links
    assert [link for link in links if not (README.parent / link).exists()] == []


def test_the_results_are_the_stored_ones():
    module = load_script(README.parent / "docs/readme_results.py")
    assert module.write_page() == TEXT, "run `python docs/readme_results.py`"
