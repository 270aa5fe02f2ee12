"""`ltm fire`: a fire on the previous and on the current fuel map, and the page that compares them."""
