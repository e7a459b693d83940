"""A rigid motion as files hold it."""

import math
from typing import Annotated

from pydantic import AfterValidator

Row4 = tuple[float, float, float, float]
Rows = tuple[Row4, Row4, Row4]

RIGID = 1e-6
"""Greatest deviation of a rotation's columns from unit length and from right angles."""


def _require_rigid(rows: Rows) -> Rows:
    (a, b, c, _), (d, e, f, _), (g, h, i, _) = rows
    columns = ((a, d, g), (b, e, h), (c, f, i))
    products = [sum(x * y for x, y in zip(p, q, strict=True)) for p in columns for q in columns]
    square = all(abs(product - (n % 4 == 0)) <= RIGID for n, product in enumerate(products))
    turned = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if not (square and turned > 0 and all(math.isfinite(row[3]) for row in rows)):
        raise ValueError(
            "must be three rows of a rotation and a shift (mm): no scale, no reflection, "
            "e.g. [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]"
        )
    return rows


RigidRows = Annotated[Rows, AfterValidator(_require_rigid)]
"""Rotation and shift (mm) side by side, a row for each axis of the frame to which it leads."""
