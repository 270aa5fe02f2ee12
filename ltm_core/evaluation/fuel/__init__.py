"""The fuel map against truth, on trials whose truth is known and on recorded runs."""
