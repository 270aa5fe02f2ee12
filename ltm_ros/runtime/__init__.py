"""Base of every node: handler, DDS node and process, topics, joins of stamps, and health."""
