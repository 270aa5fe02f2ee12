"""Core types <-> standard ROS 2 messages, one module a message family, and the recordings that hold them."""
