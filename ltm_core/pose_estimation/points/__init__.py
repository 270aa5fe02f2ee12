"""Pose from surveyed control points (resection)."""
