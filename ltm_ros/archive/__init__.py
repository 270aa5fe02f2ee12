"""Works archives of recordings again: a year of a network's frames to the same map, to the last bit."""
