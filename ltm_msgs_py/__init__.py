"""Convert core types to standard ROS 2 messages and back, one module per message family; read and write recordings."""
