"""Read recorded runs frame by frame."""
