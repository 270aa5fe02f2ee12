"""Run `make demo` and `make demo-real`: replay a recording live, score it and write a report."""
