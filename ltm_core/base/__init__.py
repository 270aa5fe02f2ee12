"""What all folders build on: errors, array types, and small tools without a subject of their own."""
