"""Study wing: recorded runs scored against truth, and the reports of it."""
