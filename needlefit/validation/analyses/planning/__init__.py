"""Plan insertions that are not made yet: which one to make next, and how to reach a target."""
