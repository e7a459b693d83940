"""Studies of the paper's tables, cell by cell: over many twins, and under other rules."""
