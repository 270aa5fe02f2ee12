"""Study wing: scores of recorded runs against truth, and their reports."""
