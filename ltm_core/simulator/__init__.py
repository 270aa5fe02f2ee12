"""Simulated sites, cameras and recordings: seeded terrain and vegetation, rendered with Mitsuba, with truth for
every pixel."""
