"""Tissue laws: how the foundation modulus depends on the stretch. Each law is one file here, or of a plugin.

A law is any smooth k(lambda; shape) > 0 with any number of named shape parameters. Where it is a sum of
powers of the stretch (`PowerLaw`), the kernel evaluates exactly that; any other one is interpolated at
Chebyshev points (`mechanics/packing.py`). Reference, kernel, derivatives and fits know every law without
naming any.
"""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.registry import Registry

Numbers = NDArray[Any]  #: real or complex

# imaginary step of complex-step differentiation, which takes no difference that would be rounded
COMPLEX_STEP = 1e-30

# names of other numbers of a layer
_TAKEN = ("mu", "friction", "boundary", "top_mm", "mu_pa", "thickness_mm")


@dataclass(frozen=True)
class ShapeParameter:
    """A number of a law, one for each layer, on which the form of k(lambda) depends."""

    #: small letters and single underscores. With the number of a layer it is that of a column or of a fit's
    #: parameter: `alpha2`.
    name: str
    symbol: str  #: in figures and tables
    explanation: str  #: what it is, in a few words
    usual: tuple[float, float]  #: bounds of a fit that states none
    default: float  #: where nothing is known of it
    bounds: tuple[float, float] = (-math.inf, math.inf)  #: what the law is meant for, in `unit`
    unit: str = ""  #: empty for a number without one. If there is one, `name` ends with it: `_mm`, `_pa`.
    #: mean and standard deviation of the normal prior of a fit that states none; None: flat in `usual`
    prior: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch("[a-z]+(_[a-z]+)*", self.name) or self.name in _TAKEN:
            raise ConfigError(
                f"a shape parameter is called `{self.name}`",
                expected=f"small letters and single underscores, none of {', '.join(_TAKEN)}",
            )

    @property
    def tested(self) -> tuple[float, float]:
        """The part of `bounds` between -10 and 10: what a page's sliders reach."""
        return max(self.bounds[0], -10.0), min(self.bounds[1], 10.0)


class TissueLaw(ABC):
    """k(lambda; shape) of one layer, over mu; k is 3 mu at small strain in all laws here.

    Functions take the stretch and then the shape parameters, in the order of `parameters`: arrays of equal
    size. They must be analytic, as numpy's are but for `abs`, and accept complex numbers: derivatives are
    complex steps. At lambda = 1 k must not depend on the shape parameters.
    """

    name: str
    label: str
    """The printed name."""
    parameters: tuple[ShapeParameter, ...] = ()

    @abstractmethod
    def k(self, stretch: Numbers, *shape: Any) -> Numbers:  # noqa: ANN401  -- a law names its parameters
        """Return the tangent modulus over mu."""

    def dk_dshape(self, number: int, stretch: Floats, *shape: Floats) -> Floats:
        """Return the derivative of k over mu by a shape parameter, `number` its place in `parameters`."""
        stepped = [value + 1j * COMPLEX_STEP * (p == number) for p, value in enumerate(shape)]
        return self.k(stretch, *stepped).imag / COMPLEX_STEP

    @cached_property
    def shape_names(self) -> tuple[str, ...]:
        """Names of the shape parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def name_shape(self, layers: Iterable[int]) -> list[list[str]]:
        """Return the shape parameters' names in layers of these numbers, a row for each of `parameters`."""
        numbers = list(layers)
        return [[f"{name}{number}" for number in numbers] for name in self.shape_names]


class PowerLaw(TissueLaw):
    """A law that is a sum of powers, k = mu sum_p c_p lambda^q_p."""

    @abstractmethod
    def terms(self, *shape: Any) -> Sequence[tuple[float, float]]:  # noqa: ANN401
        """Return the pairs (c_p, q_p), all at most linear in the shape parameters together."""

    @cached_property
    def terms_at_zero(self) -> tuple[Floats, Floats]:
        """Coefficients and exponents, each (P,), where all shape parameters are 0."""
        pairs = np.array(self.terms(*np.zeros(len(self.parameters))), dtype=np.float64)  # (P, 2)
        return pairs[:, 0].copy(), pairs[:, 1].copy()

    @cached_property
    def term_slopes(self) -> tuple[Floats, Floats]:
        """Derivatives of coefficients and exponents by the shape parameters, (parameters, P) each."""
        count, at_zero = len(self.parameters), np.column_stack(self.terms_at_zero)
        # linear: values at 0 and along each axis determine the terms everywhere
        slopes = np.array([np.array(self.terms(*unit)) - at_zero for unit in np.eye(count)])
        slopes = slopes.reshape(count, *at_zero.shape)
        return slopes[:, :, 0].copy(), slopes[:, :, 1].copy()

    def power_terms(self, shape: Numbers) -> tuple[Numbers, Numbers]:
        """Return coefficients and exponents, each (..., P), for shape parameters (..., parameters)."""
        (c, q), (dc, dq) = self.terms_at_zero, self.term_slopes
        return c + shape @ dc, q + shape @ dq

    def k(self, stretch: Numbers, *shape: Numbers) -> Numbers:
        """Return the tangent modulus over mu."""
        c, q = self.terms_at_zero
        if shape:
            c, q = self.power_terms(np.stack(np.broadcast_arrays(*shape), axis=-1))
        return np.sum(c * stretch[..., None] ** q, axis=-1)


LAWS: Registry[TissueLaw] = Registry(TissueLaw, __name__, "tissue law")  # type: ignore[type-abstract]


def list_shape_parameters() -> Iterator[ShapeParameter]:
    """Yield the shape parameters of all laws."""
    for law in LAWS.values():
        yield from law.parameters
