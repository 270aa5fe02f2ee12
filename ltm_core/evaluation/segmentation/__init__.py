"""Label networks against labelled frames."""
