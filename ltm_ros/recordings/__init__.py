"""Reads recorded runs frame by frame."""
