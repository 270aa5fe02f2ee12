"""HTML pages and JSON files of results."""
