"""A tower's health for monitoring systems and persons: one state, as numbers, as words and as a page."""
