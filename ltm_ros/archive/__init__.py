"""Reprocess archives of recordings: a year of frames gives the same map, to the last bit."""
