"""Study wing: scores of every part against truth. Nothing that a tower runs imports it."""
