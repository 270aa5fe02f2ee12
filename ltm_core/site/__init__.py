"""The site file: its configuration classes, loading, editing and checks."""
