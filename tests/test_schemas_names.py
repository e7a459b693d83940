"""Names that a spreadsheet, a terminal or a file system would act on are refused, wherever they come from."""

from needlefit.schemas.names import file_name_fault, name_fault

BAD = [
    "=1+1",
    "+1",
    "-1",
    "@SUM",
    " =1",
    "\uff1d1",
    "a\tb",
    "a\rb",
    "a\nb",
    "a\x1b[2J",
    "\u202eabc",
    "a\u200bb",
]
GOOD = ["liver 1", "µ-phantom", "piece-1", "a=b", "3+4", "Lendenstück", "x" * 200, ""]


def test_names_that_a_spreadsheet_a_terminal_or_a_file_system_would_act_on():
    for name in BAD:
        assert name_fault(name) and file_name_fault(name)
    for name in GOOD:
        assert name_fault(name) == ""
    for name in ["", ".", "..", "a/b", "../a", "a\\b", "x" * 201]:
        assert file_name_fault(name)
