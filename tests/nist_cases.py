"""The nonlinear regression problems of NIST's Statistical Reference Datasets, as goals of a search."""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from inference_cases import recipe

from needlefit.inference.fit import ObjectiveFunction, Start, StartPoint
from needlefit.inference.optimize import search

FOLDER = Path(__file__).parent / "nist"
LEVELS = ("lower", "average", "higher")
DIGITS, NEAR = 6, 1e-6

Model = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _nelson(t, x):
    time, degrees = np.repeat(x, 16), np.tile(np.repeat([180.0, 225.0, 250.0, 275.0], 4), len(x))
    return t[0] - t[1] * time * np.exp(-t[2] * degrees)


def _attenuation(t, x):
    return np.exp(-t[0] * x) / (t[1] + t[2] * x)


def _exponentials(t, x):
    return t[0] * np.exp(-t[1] * x) + t[2] * np.exp(-t[3] * x) + t[4] * np.exp(-t[5] * x)


def _cubics(t, x):
    return (t[0] + t[1] * x + t[2] * x**2 + t[3] * x**3) / (1 + t[4] * x + t[5] * x**2 + t[6] * x**3)


def _peaks(t, x):
    first, second = np.exp(-(((x - t[3]) / t[4]) ** 2)), np.exp(-(((x - t[6]) / t[7]) ** 2))
    return t[0] * np.exp(-t[1] * x) + t[2] * first + t[5] * second


def _cycles(t, x):
    year, long, short = (2 * np.pi * x / period for period in (12, t[3], t[6]))
    return (
        t[0] + t[1] * np.cos(year) + t[2] * np.sin(year)
        + t[4] * np.cos(long) + t[5] * np.sin(long) + t[7] * np.cos(short) + t[8] * np.sin(short)
    )  # fmt: skip


def _saturation(t, x):
    return t[0] * (1 - np.exp(-t[1] * x))


MODELS: dict[str, Model] = {
    "misra1a": _saturation,
    "misra1b": lambda t, x: t[0] * (1 - (1 + t[1] * x / 2) ** -2),
    "misra1c": lambda t, x: t[0] * (1 - (1 + 2 * t[1] * x) ** -0.5),
    "misra1d": lambda t, x: t[0] * t[1] * x / (1 + t[1] * x),
    "danwood": lambda t, x: t[0] * x ** t[1],
    "chwirut1": _attenuation,
    "chwirut2": _attenuation,
    "gauss1": _peaks,
    "gauss2": _peaks,
    "gauss3": _peaks,
    "kirby2": lambda t, x: (t[0] + t[1] * x + t[2] * x**2) / (1 + t[3] * x + t[4] * x**2),
    "enso": _cycles,
    "lanczos1": _exponentials,
    "lanczos2": _exponentials,
    "lanczos3": _exponentials,
    "mgh17": lambda t, x: t[0] + t[1] * np.exp(-t[3] * x) + t[2] * np.exp(-t[4] * x),
    "roszman1": lambda t, x: t[0] - t[1] * x - np.arctan(t[2] / (x - t[3])) / np.pi,
    "nelson": _nelson,
    "hahn1": _cubics,
    "thurber": _cubics,
    "mgh09": lambda t, x: t[0] * (x**2 + t[1] * x) / (x**2 + t[2] * x + t[3]),
    "boxbod": _saturation,
    "rat42": lambda t, x: t[0] / (1 + np.exp(t[1] - t[2] * x)),
    "rat43": lambda t, x: t[0] / (1 + np.exp(t[1] - t[2] * x)) ** (1 / t[3]),
    "mgh10": lambda t, x: t[0] * np.exp(t[1] / (x + t[2])),
    "eckerle4": lambda t, x: t[0] / t[1] * np.exp(-0.5 * ((x - t[2]) / t[1]) ** 2),
    "bennett5": lambda t, x: t[0] * (t[1] + x) ** (-1 / t[2]),
}


@dataclass(frozen=True)
class Regression:
    """One dataset with its model: residuals model - y, by parameters as they are, not their logarithms."""

    name: str
    level: str
    starts: tuple[tuple[float, ...], tuple[float, ...]]
    certified: tuple[float, ...]
    squares: float
    x: np.ndarray
    y: np.ndarray

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            return MODELS[self.name](theta, self.x) - self.y

    @np.errstate(all="ignore")
    def jacobian(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Exact to rounding: f(t + i h) / h has no difference in it."""
        h = 1e-30
        moved = theta + 1j * h * np.eye(len(theta))
        columns = [MODELS[self.name](t, self.x).imag / h for t in moved]
        return self.residuals(theta), np.stack(columns, axis=1)

    def goal(self, half: float = np.inf) -> ObjectiveFunction:
        """Half the sum of squares, in a box of `half` times the larger start on each side of 0."""
        size = half * np.max(np.abs(self.starts), axis=0)

        @np.errstate(over="ignore")
        def value(theta: np.ndarray) -> float:
            return 0.5 * float(np.sum(self.residuals(theta) ** 2))

        @np.errstate(over="ignore", invalid="ignore")
        def gradient(theta: np.ndarray) -> tuple[float, np.ndarray]:
            residuals, jacobian = self.jacobian(theta)
            return 0.5 * float(residuals @ residuals), residuals @ jacobian

        return ObjectiveFunction(-size, size, value, gradient, self.residuals, self.jacobian)

    def digits(self, theta: tuple[float, ...]) -> float:
        """Return how many significant digits of the worst parameter agree with the certified ones."""
        off = np.abs(self._ordered(theta) - self.certified) / np.abs(self.certified)
        return float(-np.log10(max(float(np.max(off)), 1e-11)))

    def _ordered(self, theta: tuple[float, ...]) -> np.ndarray:
        """Return theta with its exponentials by their rates, peaks by their places, cycles by their periods.

        The certified values stand so, but the sum is the same in any order.
        """
        t = np.array(theta)
        if self.name.startswith("gauss"):
            t[[4, 7]] = np.abs(t[[4, 7]])
            return t if t[3] < t[6] else t[[0, 1, 5, 6, 7, 2, 3, 4]]
        if self.name == "enso":
            return t if t[3] > t[6] else t[[0, 1, 2, 6, 7, 8, 3, 4, 5]]
        if self.name.startswith("lanczos"):
            pairs = t.reshape(3, 2)
            return pairs[np.argsort(pairs[:, 1])].ravel()
        return t[[0, 2, 1, 4, 3]] if self.name == "mgh17" and t[3] > t[4] else t


@cache
def regressions() -> dict[str, Regression]:
    tables = {level: tomllib.loads((FOLDER / f"{level}.toml").read_text("utf-8")) for level in LEVELS}
    every = {name: table for level in LEVELS for name, table in tables[level].items()}
    return {
        name: Regression(
            name,
            level,
            (tuple(map(float, table["start1"])), tuple(map(float, table["start2"]))),
            tuple(table["certified"]),
            table["squares"],
            *_measured(name, table, every),
        )
        for level in LEVELS
        for name, table in tables[level].items()
    }


def _measured(name: str, table: dict, every: dict) -> tuple[np.ndarray, np.ndarray]:
    data = every[table.get("like", name)]
    y = np.array(data["y"], dtype=float)
    x = np.array(data.get("x", range(1, len(y) + 1)), dtype=float)
    y = np.log(y) if name == "nelson" else y
    if "digits" in table:
        return x, np.array([float(f"{v:.{table['digits'] - 1}e}") for v in y])
    return x, np.round(y, table["decimals"]) if "decimals" in table else y


def ended(
    one: Regression, start: int, algorithm: str, half: float = np.inf, evaluations: int = 50_000
) -> Start:
    """What one search came to, by a recipe's algorithm."""
    how = recipe(algorithm=algorithm, evaluations=evaluations, tolerance=1e-13)
    return search(one.goal(half), how, StartPoint(0, one.starts[start]))


def attained(one: Regression, start: Start) -> bool:
    """Whether it is the certified minimum: by its sum of squares, or by its parameters."""
    return start.objective <= 0.5 * one.squares * (1 + NEAR) or one.digits(start.theta) >= DIGITS
