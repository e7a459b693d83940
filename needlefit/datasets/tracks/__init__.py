"""The second kind of observation: where the tip was at each depth, and where a guide stood meanwhile."""
