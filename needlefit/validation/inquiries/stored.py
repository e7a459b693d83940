"""An answer as one file, from which its tables, figures and report are made again."""

from pathlib import Path
from typing import Any

from needlefit.project.plain import plain
from needlefit.project.reading import is_file, stored_values
from needlefit.project.records.stored import AnswerTable
from needlefit.project.run_file import read_timing, require_form
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.kinds import KINDS
from needlefit.validation.packing import NAME, pack, packed, unpack, unpacked

_PLAIN = ("name", "origin", "dataset_title", "interrupted", "faults", "run")


def store_answer(answer: Answer, folder: Path) -> Path:
    """Write all of an answer but its times to `folder`; equal answers give equal bytes."""
    table = {
        "kind": answer.kind,
        "record": answer.record.model_dump(mode="json", by_alias=True),
        **{key: plain(getattr(answer, key)) for key in _PLAIN},
        "frames": {name: packed(frame) for name, frame in answer.frames.items()},
    }
    return pack(table, folder)


def is_answer(folder: Path) -> bool:
    """Return whether what a run left in `folder` is an answer."""
    return is_file(folder / NAME) and str(unpack(folder).get("kind")) in KINDS


def restore_answer(folder: Path) -> Answer:
    """Return the answer that a run left in `folder`; DataError if it holds none, or a damaged one."""
    table = unpack(folder)
    require_form(table, AnswerTable, str(folder / NAME))
    with stored_values(folder / NAME):
        return _restored(table, folder)


def _restored(table: dict[str, Any], folder: Path) -> Answer:
    about: dict[str, Any] = {key: table[key] for key in _PLAIN}
    return Answer(
        record=KINDS[table["kind"]].record.model_validate(table["record"]),
        frames={name: unpacked(frame) for name, frame in table["frames"].items()},
        timing=read_timing(folder),
        **{**about, "faults": tuple(about["faults"])},
    )
