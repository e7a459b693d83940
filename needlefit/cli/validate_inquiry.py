"""`needlefit validate` of a study that asks something else than "tune on these, score on those"."""

from typing import TYPE_CHECKING

from needlefit.cli import screen
from needlefit.cli.execution import Execution
from needlefit.cli.warn import warn_of
from needlefit.project.result_warnings import KEY, as_rows, warnings_of

if TYPE_CHECKING:
    from needlefit.project.records.inquiry import InquiryRecord
    from needlefit.validation.inquiries.answer import Answer


def ask(execution: Execution, name: str, record: "InquiryRecord", json: bool) -> "Answer":
    """Carry out, write and print one inquiry."""
    from needlefit.reporting.inquiries.write import write_answer

    answer = execution.ask(name, record)
    if answer.interrupted:
        raise execution.interrupted()
    folder = write_answer(answer, execution.folder(name))
    if not json:
        _show(answer)
        screen.say(f"written: {folder}/")
    warn_of(execution.invocation, answer.run)
    if not json:
        screen.say()
    return answer


def as_json(answer: "Answer") -> dict[str, object]:
    """Return the frames of an answer as plain values."""
    from needlefit.reporting.tables import records

    warnings = as_rows(warnings_of(answer.run))
    return {**{name: records(frame) for name, frame in answer.frames.items()}, KEY: warnings}


def _show(answer: "Answer") -> None:
    from needlefit.reporting.inquiries.pages import PAGES

    page = PAGES[answer.kind]
    screen.say(f"{answer.name}: {answer.title}")
    kind = "SYNTHETIC" if answer.synthetic else "measured"
    screen.say(f"  {kind} data: {answer.dataset_title}")
    for table in page.layouts(answer):
        screen.show_display(table)
    for sentence in page.said(answer):
        screen.say(sentence)
