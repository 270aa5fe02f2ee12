"""Measures of depth, labels, maps and skylines against truth."""
