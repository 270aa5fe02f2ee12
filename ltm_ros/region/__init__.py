"""The link between towers and the map of their region, over MQTT; the map itself, and what it sends and writes."""
