"""Estimates camera poses from images: resection from surveyed control points."""
