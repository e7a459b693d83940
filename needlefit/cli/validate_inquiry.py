"""`needlefit validate` of a study that asks something else than "tune on these, score on those"."""

from typing import TYPE_CHECKING

import typer

from needlefit.cli import failure, screen
from needlefit.cli.execution import Execution

if TYPE_CHECKING:
    from needlefit.project.records.inquiry import InquiryRecord
    from needlefit.validation.inquiries.answer import Answer


def validate_inquiry(execution: Execution, name: str, record: "InquiryRecord", json: bool) -> None:
    """Carry out, write and print one inquiry."""
    execution.prepare([name])
    answer = carry_out(execution, name, record, json)
    execution.forget(name)
    require_trusted([answer])


def carry_out(execution: Execution, name: str, record: "InquiryRecord", json: bool) -> "Answer":
    """Return the answer of an inquiry, written and printed; its checkpoint stays."""
    from needlefit.reporting.inquiries.write import write_answer

    answer = execution.ask(name, record)
    if answer.interrupted:
        raise execution.interrupted()
    folder = write_answer(answer, execution.folder(name))
    if json:
        from needlefit.reporting.tables import records

        screen.show_json({frame: records(rows) for frame, rows in answer.frames.items()})
    else:
        _show(answer)
        screen.say(f"written: {folder}/\n")
    return answer


def require_trusted(answers: "list[Answer]") -> None:
    """End with its exit code if something in the answers is not to be trusted; they are written by then."""
    faults = [f"{answer.name}: {fault}" for answer in answers for fault in answer.faults]
    for fault in faults:
        screen.note(f"needlefit: {fault}")
    if faults:
        raise typer.Exit(failure.NOT_CONVERGED)


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
