"""What is told of each kind of inquiry: one file a kind, entered in `pages`."""
