"""Read and write recordings: MCAP in the rosbag2 layout, without rosbag2.

Source: MCAP specification and its ros2 profile; rosbag2's metadata.yaml version 9 (Jazzy)."""
