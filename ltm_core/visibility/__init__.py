"""Visibility: map points in images, occlusion by terrain, viewsheds, and the uncertainty of traced points."""
