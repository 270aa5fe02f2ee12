"""Naming areas in photos: a web page on this machine alone, for `ltm label`."""
