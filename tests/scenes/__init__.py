"""Scenes, sites and small networks that several tests share, and the processes that some of them start."""
