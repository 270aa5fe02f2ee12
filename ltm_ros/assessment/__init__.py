"""Assess a fuel map's accuracy: the sampled cells, the interpreters' answers, the report."""
