"""Teach a label head from a few labelled photos of a site, and score it on photos held out."""
