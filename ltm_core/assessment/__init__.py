"""Assess the accuracy of a map from a stratified random sample of its cells and a person's answers about them."""
