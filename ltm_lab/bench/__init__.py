"""Benchmarks: the tracer beside other ray tracers, and the cost of the site graph, of archives and of commands."""
