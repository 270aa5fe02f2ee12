"""Measured comparisons with other people's ray tracers, on terrain that anybody can make again."""
