"""Description of cameras in files: calibration, pose, sensors and mount, with checks of units."""
