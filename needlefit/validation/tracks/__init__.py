"""Studies of tip tracks: fit to some runs, predict others reading by reading."""
