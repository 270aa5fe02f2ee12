"""Run `make demo`: replay a recording live, score it and write a report."""
