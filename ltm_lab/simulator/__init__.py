"""Study wing: simulated sites, cameras and recordings, rendered with Mitsuba, with truth for every pixel.

Terrain and vegetation are made from a seed; `ltm-lab simulate` runs it.
"""
