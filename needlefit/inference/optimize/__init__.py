"""Search for the best fit: many starts, each by one algorithm or by several in turn."""

from needlefit.inference.optimize.local_search import ALGORITHMS, search
from needlefit.inference.optimize.multistart import minimize, starting_points

__all__ = ["ALGORITHMS", "minimize", "search", "starting_points"]
