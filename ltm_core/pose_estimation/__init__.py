"""Camera poses from what a picture shows: resection from surveyed control points."""
