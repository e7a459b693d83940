"""One file a format: what it holds, as cells with their lines or as points; nothing about insertions."""
