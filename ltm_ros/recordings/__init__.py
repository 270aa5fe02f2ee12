"""Recorded runs read frame by frame."""
