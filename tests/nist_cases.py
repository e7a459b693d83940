"""The nonlinear regression problems of NIST's Statistical Reference Datasets, as goals of a search."""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from needlefit.inference.goal import Goal

FOLDER = Path(__file__).parent / "nist"
LEVELS = ("lower", "average", "higher")

Model = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _nelson(t, x):
    time, degrees = np.repeat(x, 16), np.tile(np.repeat([180.0, 225.0, 250.0, 275.0], 4), len(x))
    return t[0] - t[1] * time * np.exp(-t[2] * degrees)


def _exponentials(t, x):
    return t[0] * np.exp(-t[1] * x) + t[2] * np.exp(-t[3] * x) + t[4] * np.exp(-t[5] * x)


def _cubics(t, x):
    return (t[0] + t[1] * x + t[2] * x**2 + t[3] * x**3) / (1 + t[4] * x + t[5] * x**2 + t[6] * x**3)


def _saturation(t, x):
    return t[0] * (1 - np.exp(-t[1] * x))


MODELS: dict[str, Model] = {
    "misra1a": _saturation,
    "misra1b": lambda t, x: t[0] * (1 - (1 + t[1] * x / 2) ** -2),
    "misra1c": lambda t, x: t[0] * (1 - (1 + 2 * t[1] * x) ** -0.5),
    "misra1d": lambda t, x: t[0] * t[1] * x / (1 + t[1] * x),
    "danwood": lambda t, x: t[0] * x ** t[1],
    "chwirut2": lambda t, x: np.exp(-t[0] * x) / (t[1] + t[2] * x),
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

    def goal(self, half: float = np.inf) -> Goal:
        """Half the sum of squares, in a box of `half` times the larger start on each side of 0."""
        size = half * np.max(np.abs(self.starts), axis=0)

        @np.errstate(over="ignore")
        def value(theta: np.ndarray) -> float:
            return 0.5 * float(np.sum(self.residuals(theta) ** 2))

        @np.errstate(over="ignore", invalid="ignore")
        def gradient(theta: np.ndarray) -> tuple[float, np.ndarray]:
            residuals, jacobian = self.jacobian(theta)
            return 0.5 * float(residuals @ residuals), residuals @ jacobian

        return Goal(-size, size, value, gradient, self.residuals, self.jacobian)

    def digits(self, theta: tuple[float, ...]) -> float:
        """Return how many significant digits of the worst parameter agree with the certified ones."""
        off = np.abs(self._ordered(theta) - self.certified) / np.abs(self.certified)
        return float(-np.log10(max(float(np.max(off)), 1e-11)))

    def _ordered(self, theta: tuple[float, ...]) -> np.ndarray:
        """Return theta with its exponentials, which may stand in any order, by their rates."""
        t = np.array(theta)
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
            np.array(every[table.get("like", name)]["x"], dtype=float),
            _measured(name, table, every),
        )
        for level in LEVELS
        for name, table in tables[level].items()
    }


def _measured(name: str, table: dict, every: dict) -> np.ndarray:
    y = np.array(every[table.get("like", name)]["y"], dtype=float)
    y = np.log(y) if name == "nelson" else y
    if "digits" in table:
        return np.array([float(f"{v:.{table['digits'] - 1}e}") for v in y])
    return np.round(y, table["decimals"]) if "decimals" in table else y
