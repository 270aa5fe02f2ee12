"""The demonstrations behind `make demo` and `make demo-real`: the live graph, scored, with a report to look at."""
