"""Label areas in photos: a local web page for `ltm label`."""
