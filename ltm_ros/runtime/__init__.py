"""What every node is made of: its handler, its life on DDS, its topics, joins and health."""
