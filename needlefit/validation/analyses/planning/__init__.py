"""Studies of insertions not made yet: what the next one would determine, and how to reach a target."""
