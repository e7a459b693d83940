"""What an error shows, whatever the file held that it is about."""

import pytest

from needlefit.errors import MAX_MESSAGE_CHARACTERS, DataError, printable


@pytest.mark.parametrize("text", ["\x1b[2J", "\x1b]0;t\x07", "a\rb", "\x00", "\x9b31m", "\u202e", "\udcff"])
def test_control_characters_of_a_terminal_are_escaped(text):
    shown = str(DataError(f"is {text}", where=f"{text}.csv", expected=text, fix=text))
    assert shown.isprintable() or set("\n") == {c for c in shown if not c.isprintable()}
    assert text not in shown
    shown.encode("utf-8")


def test_words_of_any_language_and_line_ends_stay():
    text = "Länge: 3 µm\n  漢字\tß"
    assert printable(text) == text


@pytest.mark.parametrize("text", ["A" * 10**6, "short line\n" * 10**5, "\x1b" * 10**6])
def test_messages_have_a_length_limit(text):
    assert len(str(DataError(text))) < 7 * MAX_MESSAGE_CHARACTERS
    assert str(DataError(text)).startswith(printable(text[:20]))
