"""Headers of image files, checked before a native reader opens the file."""
