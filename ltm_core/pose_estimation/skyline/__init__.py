"""Pose from the skyline and the ridges in a photo."""
