"""Study wing: benchmarks of the running graph."""
