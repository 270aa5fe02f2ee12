"""The ROS 2 side of LTM: thin nodes, the graph that they form, replay, recording, the viewer and the command line."""
