"""Hostile files and messages against every reader and every handler of the graph: `make fuzz`, and a minute of it in
`make test`."""
