"""Fuel maps as the files that fire models and GIS read."""
