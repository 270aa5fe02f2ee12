"""Read frames from cameras: images, their times, viewing directions and the cameras' states."""
