"""Studies of tip tracks: fit to some runs, foretell others reading by reading."""
