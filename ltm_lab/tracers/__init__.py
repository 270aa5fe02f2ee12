"""Tracers for comparison: the paper's march as printed, and a slow float64 reference."""
