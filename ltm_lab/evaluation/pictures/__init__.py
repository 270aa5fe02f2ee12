"""Study wing: pictures that only evaluations draw."""
