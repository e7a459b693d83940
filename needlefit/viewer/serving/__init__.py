"""The server of the interactive simulation: access control, connections, and one trial for each window."""
