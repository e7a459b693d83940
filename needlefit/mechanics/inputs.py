"""The inputs of a steered needle by name, and what values they take; pages and recordings use them."""

import math
from dataclasses import dataclass, fields
from typing import Any, Literal

from needlefit.errors import ModelError
from needlefit.mechanics.laws import LAWS, list_shape_parameters
from needlefit.mechanics.shape import LIMITS
from needlefit.schemas.limits import MAX_NEEDLE_LENGTH_MM, MAX_NUMBER

MAX_GUIDE_NUMBER = 32  #: largest number that a guide may have
MAX_CUT_ANGLE_DEG = 45.0  #: angle of the cut (degrees) below which that of an input must be
MAX_MU_PA = 1e15  #: largest mu (Pa): beyond it, rounding exceeds the needle's own stiffness
#: smallest distance (mm) of the base from the first guide: a span below about four diameters is no beam
BASE_CLEARANCE_MM = 5.0


@dataclass(frozen=True)
class Input:
    """The object that the item number of an input counts, and what its value must be; the page reads it too.

    `parameter`: it is one of the model, which applies to the whole insertion.
    """

    item: Literal["guide", "layer"] | None = None
    expected: str = ""
    least: float = -math.inf  #: least, above: lower bound that the value may have, or may not
    above: float = -math.inf
    upto: float = math.inf  #: upto, below: upper bound that it may have, or may not
    below: float = math.inf
    values: tuple[float, ...] = ()  #: where there are only these
    parameter: bool = False

    def allows(self, value: float) -> bool:
        """Whether a finite value is one that the input takes."""
        within = self.least <= value <= self.upto and self.above < value < self.below
        return within and (not self.values or value in self.values)

    def to_message(self) -> dict[str, Any]:
        """Return what differs from the defaults, for JSON."""
        return {
            field.name: value
            for field in fields(self)
            if (value := getattr(self, field.name)) != field.default
        }


_SLOPE: dict[str, Any] = {
    "expected": "between -45° and 45° (dy/dx between -1 and 1)",
    "above": -1.0,
    "below": 1.0,
}
_FLAG: dict[str, Any] = {"expected": "0 or 1", "values": (0.0, 1.0)}
_LENGTH: dict[str, Any] = {"expected": "0 mm or above", "least": 0.0}
_ANGLE: dict[str, Any] = {
    "expected": f"from 0 to {MAX_CUT_ANGLE_DEG:g}°",
    "least": 0.0,
    "below": MAX_CUT_ANGLE_DEG,
}
_MODULUS: dict[str, Any] = {
    "expected": f"above 0, up to {MAX_MU_PA / 1e6:g} MPa",
    "above": 0.0,
    "upto": MAX_MU_PA,
}

#: all inputs but shape parameters of tissue laws, which are further ones of layers
INPUTS = {
    "depth_mm": Input(**_LENGTH),
    "bevel_side": Input(expected="+1 (y > 0) or -1", values=(1.0, -1.0)),
    "bevel_roll_deg": Input(),
    "bevel_offset_mm": Input(**_LENGTH),
    "cut_angle_deg": Input(**_ANGLE),
    "base_y_mm": Input(),
    "base_slope": Input(**_SLOPE),
    "guide_x_mm": Input("guide"),
    "guide_y_mm": Input("guide"),
    "guide_slope": Input("guide", **_SLOPE),
    "guide_turns_freely": Input("guide", **_FLAG),
    "guide_engaged": Input("guide", **_FLAG),
    "tip_y_mm": Input(),
    "tip_slope": Input(**_SLOPE),
    "tip_held": Input(**_FLAG),
    "mu_pa": Input("layer", **_MODULUS, parameter=True),
    "offset_throughout_mm": Input(**_LENGTH, parameter=True),
    "cut_angle_throughout_deg": Input(**_ANGLE, parameter=True),
    "return_to": Input(expected="the number of a step", least=0.0),
}

_SHAPE_PARAMETER = Input("layer", parameter=True)


def find_input(name: str) -> Input:
    """Return what an input may be; ModelError if there is no such input."""
    if name not in INPUTS and all(parameter.name != name for parameter in list_shape_parameters()):
        raise ModelError(f"there is no input `{name}`", expected=f"one of {', '.join(INPUTS)}")
    return INPUTS.get(name, _SHAPE_PARAMETER)


def describe_input_rules(law: str) -> dict[str, Any]:
    """Return what the inputs of a needle may be in tissue of a law, and the limits of validity, for JSON."""
    shape_inputs = {name: find_input(name) for name in LAWS[law].shape_names}
    return {
        "inputs": {name: rule.to_message() for name, rule in (INPUTS | shape_inputs).items()},
        "max": MAX_NUMBER,
        "max_mm": MAX_NEEDLE_LENGTH_MM,
        "max_guide": MAX_GUIDE_NUMBER,
        "clearance_mm": BASE_CLEARANCE_MM,
        "validity": LIMITS,
    }
