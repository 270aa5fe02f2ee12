"""Link towers to the map of their region over MQTT; keep the map, publish tiles and write exports."""
