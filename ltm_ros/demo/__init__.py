"""`make demo` and `make demo-real`: run the live graph on a recording, score it and write a report."""
