"""Recordings through the graph: live over DDS, or offline through the same handlers."""
