"""The nodes of the graph, one module each: `python -m ltm_ros.nodes.<node>`."""
