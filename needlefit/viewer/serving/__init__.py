"""The way between a page and its needle: the server, its door, one window after the other."""
