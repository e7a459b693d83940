"""The tissue: layers that resist the needle's deflection away from its own cut."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.errors import ModelError
from needlefit.mechanics.laws import LAWS, TissueLaw
from needlefit.mechanics.native import MAX_SHAPES
from needlefit.mechanics.needle import is_bounded, require_type
from needlefit.schemas.limits import MAX_LAYERS
from needlefit.schemas.scene import LayerRecord

MAX_MU_MPA = 1e4  #: largest mu (MPa): no tissue is as stiff as 10 GPa
#: largest mu (MPa) of a value that was not checked: a larger number is more likely one in Pa
LIKELY_MU_MPA = 100.0


@dataclass(frozen=True, init=False)
class Tissue:
    """The layers of a tissue, from the entry inwards; their number n is the length of `mu`.

    `mu` is in MPa (N/mm^2), a millionth of its value in files, where it is in Pa. `boundaries` and
    `thickness` are in mm, `torsional_friction` in N. Moduli above 100 MPa and two boundaries at one
    depth are refused, unless `is_checked`: they come from a file that was checked, or from a fit.
    """

    mu: Floats  #: (n,) effective foundation modulus of each layer, MPa; not a material constant
    #: (p, n) shape parameters of the law, in the order of its `parameters`. They may be given by name, each
    #: (n,) or one number for all layers: `shape={"jm": [2.0, 5.0]}`; `alpha=` is short for `shape={"alpha":
    #: ...}`.
    shape: Floats
    boundaries: Floats  #: (n - 1,) depths of the interfaces along C's x axis, mm, increasing
    thickness: Floats  #: (n,) tissue compressed by the deflection, mm
    friction: Floats  #: (n,) friction coefficient gamma between shaft and tissue
    law: str  #: a file of `mechanics/laws`
    torsional_friction: float  #: tau: torque per length that a turning shaft has to overcome, N mm / mm
    is_checked: bool = field(compare=False, repr=False)  #: whether its units were judged where it was made

    def __init__(
        self,
        mu: ArrayLike,
        shape: Mapping[str, ArrayLike] | ArrayLike = (),
        boundaries: ArrayLike = (),
        thickness: ArrayLike = 40.0,
        friction: ArrayLike = 0.0,
        law: str = "ogden",
        *,
        alpha: ArrayLike | None = None,
        torsional_friction: float = 0.0,
        is_checked: bool = False,
    ) -> None:
        mu = _to_floats("mu", mu)
        n = np.size(mu)
        if n > MAX_LAYERS:
            raise ModelError(f"tissue has {n} layers", expected=f"at most {MAX_LAYERS}")
        require_type("the tissue law", law, str)
        given = {"mu": (mu, n), "thickness": (thickness, n), "friction": (friction, n)}
        for name, (value, size) in (given | {"boundaries": (boundaries, n - 1)}).items():
            object.__setattr__(self, name, _to_layer_array(name, value, size))
        object.__setattr__(self, "law", law)
        object.__setattr__(self, "torsional_friction", torsional_friction)
        object.__setattr__(self, "is_checked", is_checked)
        if not (is_bounded(torsional_friction) and torsional_friction >= 0):
            raise ModelError(f"torsional friction is {torsional_friction} N", expected="0 or above")
        object.__setattr__(
            self, "shape", _to_shape_array(LAWS[law], shape if alpha is None else {"alpha": alpha}, n)
        )
        # A fit makes thousands of these: plain numbers are checked ten times as fast as such small arrays.
        tops = [0.0, *self.boundaries.tolist()]
        if any(deeper < top or (deeper == top and not is_checked) for top, deeper in pairwise(tops)):
            raise ModelError(
                f"layer boundaries are {self.boundaries.tolist()} mm",
                expected="depths that increase, none negative",
            )
        max_mu = MAX_MU_MPA if is_checked else LIKELY_MU_MPA
        words = f"above 0, at most {max_mu:g} MPa; 2e5 Pa are 0.2 MPa"
        # the greatest one too, of which a fit has the rounded logarithm
        _require("mu", " MPa", self.mu, lambda value: 0 < value <= max_mu * (1 + 1e-9), words)
        _require("thickness", " mm", self.thickness, lambda value: value > 0, "above 0")
        _require("friction", "", self.friction, lambda value: value >= 0, "0 or above")

    @property
    def alpha(self) -> Floats:
        """The shape parameter alpha of all layers, (n,), of a law that has it."""
        names = LAWS[self.law].shape_names
        if "alpha" not in names:
            raise ModelError(f"the tissue law `{self.law}` has no alpha", expected=f"of {', '.join(names)}")
        return self.shape[names.index("alpha")]

    @property
    def layers(self) -> int:
        """Number of layers."""
        return len(self.mu)

    @classmethod
    def from_records(cls, layers: Sequence[LayerRecord], law: str, torsional_friction: float = 0.0) -> Self:
        """Return the tissue that validated layer records describe (Pa become MPa)."""
        names = LAWS[law].shape_names
        for number, layer in enumerate(layers, start=1):
            # a law without shape parameters ignores an alpha
            stated = layer.shape_values if names else layer.shape
            _check_names(names, stated, f"layer {number} of the tissue law `{law}`")
        return cls(
            mu=np.array([layer.mu_pa * 1e-6 for layer in layers]),
            shape={name: [layer.shape_values[name] for layer in layers] for name in names},
            boundaries=np.array([layer.top_mm for layer in layers[1:]]),
            thickness=np.array([layer.thickness_mm for layer in layers]),
            friction=np.array([layer.friction for layer in layers]),
            law=law,
            torsional_friction=torsional_friction,
            is_checked=True,
        )


def _require(name: str, unit: str, values: Floats, right: Callable[[float], bool], expected: str) -> None:
    """Raise ModelError for the first layer whose value is not right."""
    for layer, value in enumerate(values.tolist(), start=1):
        if not right(value):
            raise ModelError(f"layer {layer} has {name} {value:g}{unit}", expected=f"{name} {expected}")


def _to_layer_array(name: str, value: ArrayLike, size: int) -> Floats:
    """Return `value` as a (size,) array; one number stands for all layers."""
    array = _to_floats(name, value)
    if array.ndim != 1 or (len(array) != size and not (len(array) == 1 and size > 0)):
        raise ModelError(f"tissue {name} has shape {array.shape}", expected=f"({size},)")
    if not is_bounded(*array.tolist()):
        raise ModelError(f"tissue {name} is {array.tolist()}", expected="finite numbers")
    return array if len(array) == size else np.full(size, array[0])


def _to_floats(name: str, value: ArrayLike) -> Floats:
    """Return a copy of `value` as an array of one dimension or more."""
    try:
        return np.array(value, dtype=np.float64, ndmin=1)
    except (TypeError, ValueError):
        raise ModelError(f"tissue {name} is {value!r:.60}", expected="numbers, one for each layer") from None


def _to_shape_array(law: TissueLaw, given: Mapping[str, ArrayLike] | ArrayLike, size: int) -> Floats:
    """Return the shape parameters of a law in `size` layers, (p, size).

    A law without any ignores an alpha that is left from another law.
    """
    names = law.shape_names
    if len(names) > MAX_SHAPES:
        raise ModelError(
            f"the tissue law `{law.name}` has {len(names)} shape parameters", expected=f"at most {MAX_SHAPES}"
        )
    if not names:
        return np.empty((0, size))
    if not isinstance(given, Mapping):
        rows = _to_floats("shape", given)
        rows = rows[None] if len(names) == 1 and rows.ndim == 1 else rows
        if len(rows) != len(names):
            raise ModelError(f"tissue shape has shape {rows.shape}", expected=f"({len(names)}, {size})")
        given = dict(zip(names, rows, strict=True))
    _check_names(names, given, f"the tissue law `{law.name}`")
    array = np.array([_to_layer_array(name, given[name], size) for name in names])
    for parameter, values in zip(law.parameters, array.tolist(), strict=True):
        for layer, value in enumerate(values, start=1):
            if not parameter.bounds[0] <= value <= parameter.bounds[1]:
                raise ModelError(
                    f"layer {layer}: {parameter.name} = {value:g}",
                    expected="{:g} to {:g}".format(*parameter.bounds),
                )
    return array


def _check_names(names: Sequence[str], given: Iterable[str], whose: str) -> None:
    """Raise ModelError unless exactly the shape parameters `names` are given."""
    missing, extra = (
        [name for name in names if name not in given],
        [name for name in given if name not in names],
    )
    if missing or extra:
        faults = [f"no {name} is given" for name in missing] + [f"there is no {name}" for name in extra]
        raise ModelError(f"{whose}: {', '.join(faults)}", expected=f"{', '.join(names)}")
