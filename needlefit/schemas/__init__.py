"""The checked forms of all files: what a user writes in TOML, and what needlefit stores."""
