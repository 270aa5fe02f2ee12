"""Scores poses found in pictures against those that the pictures were rendered with."""
