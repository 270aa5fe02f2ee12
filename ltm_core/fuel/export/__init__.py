"""Write fuel maps as files for fire models and GIS."""
