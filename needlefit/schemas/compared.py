"""Where needles are compared; a file of its own, which a simulation loads without the studies."""

from typing import Literal

Compared = Literal["plane", "space"]  #: in their planes, or in space
DIRECTIONS: dict[Compared, int] = {"plane": 1, "space": 2}  #: deflections of a point that are compared
