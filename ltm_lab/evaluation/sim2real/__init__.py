"""Study wing: distances between simulated and real pictures."""
