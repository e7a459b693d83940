"""What a person corrects in a scan."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.faults import as_error
from needlefit.errors import DataError
from needlefit.imaging.registration.rigid import MIN_MARKERS
from needlefit.imaging.scans import Scan, placed_contact_fault

MAX_BALLS = 64
"""Balls that may be placed by hand."""

BALLS_FILE = "balls.csv"

DIGITS = 3
"""Decimals of a place, mm: as many as the files keep, so that these give the same numbers again."""


@dataclass(frozen=True)
class Corrections:
    """Places that a person gave, LPS, mm; None: as found.

    Attributes
    ----------
    needle : (3,) array or None
        A point on the tube that is the needle.
    balls : (M, 3) array or None
        All balls.
    contact, tip : (3,) array or None
        Where the needle enters the tissue, and where it ends.
    """

    needle: Floats | None = None
    balls: Floats | None = None
    contact: Floats | None = None
    tip: Floats | None = None

    @property
    def any(self) -> bool:
        """Whether anything was corrected."""
        return any(part is not None for part in (self.needle, self.balls, self.contact, self.tip))

    def to_json(self) -> dict[str, Any]:
        """Return the places as JSON values."""
        parts = {"needle": self.needle, "balls": self.balls, "contact": self.contact, "tip": self.tip}
        return {name: None if part is None else part.tolist() for name, part in parts.items()}


def read_corrections(content: object) -> Corrections:
    """Return the corrections that a page sent.

    Raises
    ------
    DataError
        If they are not places.
    """
    if not isinstance(content, Mapping):
        raise DataError("the corrections are no table", expected="needle, balls, contact, tip")
    return Corrections(
        needle=_read_point(content.get("needle"), "needle"),
        balls=_read_points(content.get("balls")),
        contact=_read_point(content.get("contact"), "contact"),
        tip=_read_point(content.get("tip"), "tip"),
    )


def _read_point(given: object, name: str) -> Floats | None:
    if given is None:
        return None
    if not isinstance(given, Sequence) or len(given) != 3 or not all(_is_number(x) for x in given):
        raise DataError(f"{name} is {json.dumps(given)[:60]}", expected="three numbers, LPS, mm")
    return np.array([round(float(x), DIGITS) for x in given])


def _read_points(given: object) -> Floats | None:
    if given is None:
        return None
    if not isinstance(given, Sequence) or isinstance(given, str) or len(given) > MAX_BALLS:
        raise DataError("balls are no list of places", expected=f"at most {MAX_BALLS} places, LPS, mm")
    points = [_read_point(one, "a ball") for one in given]
    return np.array([one for one in points if one is not None]).reshape(-1, 3)


def _is_number(given: object) -> bool:
    return isinstance(given, int | float) and not isinstance(given, bool) and abs(given) < 1e6


def _require_balls(count: int, scan: Scan) -> None:
    if scan.markers is None:
        raise DataError(
            "balls were placed, but the scan has no known places to lay them on",
            expected="the markers' known places in the world",
            fix="start the page with --markers FILE, or with a table of scans that names them",
        )
    if count < MIN_MARKERS:
        raise DataError(
            f"{count} of at least {MIN_MARKERS} balls are left",
            expected=f"{MIN_MARKERS} or more that are not on a line: they register the scan to the world",
            fix="add balls, or take the removal back",
        )


def correct_scan(scan: Scan, corrections: Corrections, folder: Path) -> Scan:
    """Return the scan with the corrections; the balls that it then names are written to `folder`.

    Raises
    ------
    DataError
        If balls are given to a scan without markers, or too few, or an entry beside that of the stage.
    """
    if corrections.balls is not None:
        _require_balls(len(corrections.balls), scan)
    if corrections.contact is not None and scan.stage is not None:
        raise as_error([placed_contact_fault(scan.id)], scan.volume)
    fiducials = scan.fiducials
    if corrections.balls is not None:
        fiducials = folder / BALLS_FILE
        lines = ["x_mm,y_mm,z_mm", *(",".join(f"{x:.{DIGITS}f}" for x in ball) for ball in corrections.balls)]
        fiducials.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return replace(
        scan,
        mask=scan.mask if corrections.needle is None else None,
        fiducials=fiducials,
        needle_at=scan.needle_at if corrections.needle is None else corrections.needle,
        contact=scan.contact if corrections.contact is None else corrections.contact,
        tip=scan.tip if corrections.tip is None else corrections.tip,
    )
