"""Long work in pieces, each kept as it is finished: what was interrupted goes on to the same bytes."""

import json
from collections.abc import Callable, Iterable, Mapping

from needlefit.validation.checkpoint import Checkpoint
from needlefit.validation.job import Settings
from needlefit.validation.packing import listed
from needlefit.validation.score import Row

Rows = dict[str, list[Row]]
"""Rows by the name of the frame that they belong to."""

Piece = Callable[[], Rows]
"""Computes rows from nothing but what it is the piece of; its randomness is keyed by that too."""

_KEPT = "pieces"


def piecewise(
    pieces: Mapping[str, Piece], label: str, settings: Settings, checkpoint: Checkpoint
) -> tuple[Rows, bool]:
    """Return the rows of all pieces, in their order, and whether a stop left some of them undone.

    What a stop catches half done is thrown away: it would not be the piece that it says it is.
    """
    kept: dict[str, Rows] = {row["piece"]: row["rows"] for row in checkpoint.rows(_KEPT, ("piece", "rows"))}
    done = len(kept.keys() & pieces.keys())
    for key, piece in pieces.items():
        if key in kept:
            continue
        settings.progress(f"{label}: {key}", done, len(pieces))
        rows = None if settings.stop() else json.loads(json.dumps(piece(), default=listed))
        if rows is None or settings.stop():
            break
        checkpoint.keep_row(_KEPT, {"piece": key, "rows": rows})
        kept[key] = rows
        done += 1
    settings.progress(label, done, len(pieces))
    return joined([kept[key] for key in pieces if key in kept]), done < len(pieces)


def joined(parts: Iterable[Rows]) -> Rows:
    """Return the rows of several parts, one after the other."""
    every: Rows = {}
    for part in parts:
        for frame, rows in part.items():
            every.setdefault(frame, []).extend(rows)
    return every
