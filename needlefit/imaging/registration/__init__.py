"""Register the markers of a scan with their known positions in the world; `register` is the entry point."""
