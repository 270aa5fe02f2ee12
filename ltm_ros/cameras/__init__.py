"""Cameras as sources of frames: what they send, when it was taken, where they looked, and whether they are well."""
