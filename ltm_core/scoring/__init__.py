"""Scores of depth, labels, skylines and fuel maps against truth."""
