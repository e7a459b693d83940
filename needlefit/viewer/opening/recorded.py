"""A recording, to be carried out again before one's eyes."""

from dataclasses import replace

from needlefit.errors import NeedlefitError
from needlefit.viewer.opening import open_subject
from needlefit.viewer.recording.log import Recording
from needlefit.viewer.subject import Subject


def open_recorded(recording: Recording) -> Subject:
    """Return the scene of a recording, with what was shown beside it where that is still there unchanged."""
    head = recording.head
    alone = Subject(
        head.subject,
        head.scene.title or head.subject,
        "Opened from a recording.",
        head.scene,
        head.first_cell_mm,
        head.placement,
    )
    try:
        found = open_subject(head.subject)
    except NeedlefitError as error:
        return replace(alone, note=f"{alone.note} What was shown beside it is not found: {error.what}.")
    if found.record != head.scene:
        return replace(
            alone, note=f"{alone.note} {head.subject} has changed since and is not shown beside it."
        )
    return replace(found, first_cell=head.first_cell_mm)
