"""Locate marks in images on the map, with their uncertainty, and project places into images.

`region` has the marks, `locator` locates them, `posterior` is the probability of the result, and `answer` describes it
in usual coordinates and finds the views of a place."""
