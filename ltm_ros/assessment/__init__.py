"""Assess the accuracy of a fuel map: sampled cells, their reference answers, and what the map learns from them."""
