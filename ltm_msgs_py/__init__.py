"""Converts core types to standard ROS 2 messages and back, one module a message family; reads and writes recordings."""
