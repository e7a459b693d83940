"""Studies of insertions not made yet: what the next one would tell, and how one comes to a target."""
