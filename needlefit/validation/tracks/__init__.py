"""Run studies of tip tracks: fit to some runs, and predict others reading by reading."""
