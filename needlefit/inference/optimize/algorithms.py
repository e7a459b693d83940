"""The algorithms that a recipe may name, alone or one after the other."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import nlopt
import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ConfigError
from needlefit.inference.goal import Goal
from needlefit.inference.ledger import Ledger
from needlefit.inference.optimize import by_nlopt, by_squares

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Algorithm:
    """One way to search from one point.

    Attributes
    ----------
    run : callable
        Ledger, theta to start from (P,), tolerance of the recipe -> why it ended.
    asks : "value", "gradient" or "jacobian"
        What of the goal it evaluates.
    stochastic : bool
        Whether it draws random numbers.
    dimensions : int
        The fewest free parameters that it can search; below, Nelder-Mead takes its place.
    """

    run: Callable[[Ledger, Floats, float], str]
    asks: Literal["value", "gradient", "jacobian"] = "value"
    stochastic: bool = False
    dimensions: int = 1


def _squares(books: Ledger, start: Floats, tolerance: float) -> str:
    return by_squares.stage(books, start)  # its end is rounding, whatever the recipe's tolerance


def _of_nlopt(code: int, sloped: bool, books: Ledger, start: Floats, tolerance: float) -> str:
    return by_nlopt.stage(books, code, sloped, tolerance, start)


def _valued(code: int, stochastic: bool = False, dimensions: int = 1) -> Algorithm:
    return Algorithm(partial(_of_nlopt, code, False), "value", stochastic, dimensions)


def _sloped(code: int) -> Algorithm:
    return Algorithm(partial(_of_nlopt, code, True), "gradient")


ALGORITHMS = {
    "leastsquares": Algorithm(_squares, "jacobian"),
    "slsqp": _sloped(nlopt.LD_SLSQP),
    "lbfgs": _sloped(nlopt.LD_LBFGS),
    "var2": _sloped(nlopt.LD_VAR2),
    "tnewton": _sloped(nlopt.LD_TNEWTON_PRECOND_RESTART),
    "mma": _sloped(nlopt.LD_MMA),
    "ccsaq": _sloped(nlopt.LD_CCSAQ),
    "sbplx": _valued(nlopt.LN_SBPLX),
    "bobyqa": _valued(nlopt.LN_BOBYQA, dimensions=2),
    "neldermead": _valued(nlopt.LN_NELDERMEAD),
    "cobyla": _valued(nlopt.LN_COBYLA),
    "praxis": _valued(nlopt.LN_PRAXIS, stochastic=True, dimensions=2),
    "crs2": _valued(nlopt.GN_CRS2_LM, stochastic=True),
    "isres": _valued(nlopt.GN_ISRES, stochastic=True),
    "esch": _valued(nlopt.GN_ESCH, stochastic=True),
}
"""What a recipe may ask for: `leastsquares`, `bobyqa+neldermead`, `crs2+slsqp`."""


def stages(name: str, goal: Goal) -> tuple[Algorithm, ...]:
    """Return the algorithms that a recipe's `algorithm` names, e.g. `crs2+leastsquares`.

    Raises
    ------
    ConfigError
        If one of them is unknown, or asks for what the goal has not.
    """
    parts = [part.strip() for part in name.split("+")]
    unknown = [part for part in parts if part not in ALGORITHMS]
    if unknown:
        raise ConfigError(
            f"there is no algorithm `{unknown[0]}`",
            where="recipe, key `algorithm` or `metric_algorithm`",
            expected=f"one of {', '.join(ALGORITHMS)}, or several joined by +",
            fix="correct its name",
        )
    has = {"value": goal.value, "gradient": goal.gradient, "jacobian": goal.jacobian}
    for part in parts:
        if has[ALGORITHMS[part].asks] is None:
            raise ConfigError(
                f"`{part}` needs a {ALGORITHMS[part].asks}, which what is minimised has not",
                where="recipe, key `algorithm` or `metric_algorithm`",
                expected="slsqp or bobyqa+neldermead: a metric, or depths by quadrature, are no squares",
            )
    named = (ALGORITHMS[part] for part in parts)
    return tuple(a if len(goal.lower) >= a.dimensions else ALGORITHMS["neldermead"] for a in named)
