"""Mounts of fixed and pan-tilt-zoom cameras: calibration, shared corrections, and detection of turns."""
