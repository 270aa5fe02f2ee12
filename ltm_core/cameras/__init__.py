"""How a camera is described in files: calibration, pose, sensors and mount, with checks of units."""
