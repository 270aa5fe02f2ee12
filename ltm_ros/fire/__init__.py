"""`ltm fire`: simulate a fire on the previous and on the current fuel map, and write a page that compares them."""
