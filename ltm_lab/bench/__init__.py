"""Study wing: benchmarks of the tracer against other ray tracers, and of the cost of each step a frame."""
