"""The tissue: layers that resist the needle's deflection away from its own cut."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics.needle import is_bounded
from needlefit.schemas.limits import MAX_LAYERS
from needlefit.schemas.scene import LayerRecord


@dataclass(frozen=True)
class Tissue:
    """The layers of a tissue, from the entry inwards; their number n is the length of `mu`.

    Attributes
    ----------
    mu : (n,) array
        Effective foundation modulus of each layer, MPa; not a material constant.
    alpha : (n,) array
        Nonlinearity of each layer's law.
    boundaries : (n - 1,) array
        Depths of the interfaces along C's x axis, mm, increasing.
    thickness : (n,) array
        Tissue compressed by the deflection, mm.
    friction : (n,) array
        Friction coefficient gamma between shaft and tissue.
    law : str
        A file of `mechanics/laws`.
    """

    mu: Floats
    alpha: Floats
    boundaries: Floats = field(default_factory=lambda: np.empty(0))
    thickness: Floats = field(default_factory=lambda: np.array([40.0]))
    friction: Floats = field(default_factory=lambda: np.array([0.0]))
    law: str = "ogden"

    def __post_init__(self) -> None:
        n = np.size(self.mu)
        if n > MAX_LAYERS:
            raise ModelError(f"tissue has {n} layers", expected=f"at most {MAX_LAYERS}")
        for name, size in (("mu", n), ("alpha", n), ("thickness", n), ("friction", n), ("boundaries", n - 1)):
            object.__setattr__(self, name, _to_layer_array(name, getattr(self, name), size))
        # A fit makes thousands of these: plain numbers are checked ten times as fast as such small arrays.
        tops = [0.0, *self.boundaries.tolist()]
        if any(deeper < top for top, deeper in pairwise(tops)):
            raise ModelError(
                f"layer boundaries are {self.boundaries.tolist()} mm",
                expected="depths that increase, none negative",
            )
        _require("mu", " MPa", self.mu, lambda value: value > 0, "above 0")
        _require("thickness", " mm", self.thickness, lambda value: value > 0, "above 0")
        _require("friction", "", self.friction, lambda value: value >= 0, "0 or above")

    @property
    def layers(self) -> int:
        """Number of layers."""
        return len(self.mu)

    @classmethod
    def from_records(cls, layers: Sequence[LayerRecord], law: str) -> Self:
        """Return the tissue that validated layer records describe (Pa become MPa)."""
        return cls(
            mu=np.array([layer.mu_pa * 1e-6 for layer in layers]),
            alpha=np.array([layer.alpha for layer in layers]),
            boundaries=np.array([layer.top_mm for layer in layers[1:]]),
            thickness=np.array([layer.thickness_mm for layer in layers]),
            friction=np.array([layer.friction for layer in layers]),
            law=law,
        )


def _require(name: str, unit: str, values: Floats, right: Callable[[float], bool], expected: str) -> None:
    """Raise ModelError for the first layer whose value is not right."""
    for layer, value in enumerate(values.tolist(), start=1):
        if not right(value):
            raise ModelError(f"layer {layer} has {name} {value:g}{unit}", expected=f"{name} {expected}")


def _to_layer_array(name: str, value: ArrayLike, size: int) -> Floats:
    """Return `value` as a (size,) array; one number stands for all layers."""
    array = np.array(value, dtype=np.float64, ndmin=1)  # a copy
    if array.ndim != 1 or (len(array) != size and not (len(array) == 1 and size > 0)):
        raise ModelError(f"tissue {name} has shape {array.shape}", expected=f"({size},)")
    if not is_bounded(*array.tolist()):
        raise ModelError(f"tissue {name} is {array.tolist()}", expected="finite numbers")
    return array if len(array) == size else np.full(size, array[0])
