"""Search for the best fit: many starts, each by one algorithm or several, in a shell that keeps the books."""

from needlefit.inference.optimize.algorithms import ALGORITHMS
from needlefit.inference.optimize.multistart import minimize, starting_points
from needlefit.inference.optimize.search import search

__all__ = ["ALGORITHMS", "minimize", "search", "starting_points"]
