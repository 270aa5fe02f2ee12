"""Surface map: estimate surface heights from fused depth and detect changes on which several views agree.

`observation` turns a depth image into observations of cells, `cell_update` keeps a robust recursive estimate of each,
`change` decides by consensus, and `surface_map` is the class in front of them, which the node `terrain` uses."""
