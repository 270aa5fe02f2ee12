"""Tracers that ours is held against: the paper's march as printed, and a slow float64 reference."""
