"""Frames with truth: read from the folders that `ltm-lab simulate` writes, and from recordings."""
