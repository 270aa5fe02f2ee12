"""Locating: from what is marked in images to a place on the map, with what is not known of it, and back.

`region` is what is marked, `locator` finds where it stands, `posterior` is the answer's probability, `answer` what is
said of it in the coordinates that people use, `place` the way back: where the cameras see a place.
"""
