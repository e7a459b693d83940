"""Interactive simulation of an insertion, in the browser."""
