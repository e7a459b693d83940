"""The interactive simulation: a needle in somebody's hand, in the browser."""
