"""Locate marks in images on the map, with their uncertainty, and project places into images.

`region` is what is marked, `locator` finds where it stands, `posterior` is the answer's probability, `answer` what is
said of it in the coordinates that people use, `place` the way back: where the cameras see a place.
"""
