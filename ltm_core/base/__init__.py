"""Common base of all folders: errors, array types and small tools."""
