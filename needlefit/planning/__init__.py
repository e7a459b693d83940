"""Plans of insertions: where to enter (`aiming`), and how to steer (`steering`), past obstacles."""
