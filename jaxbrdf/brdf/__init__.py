"""Reflectance models, one family a file; base.py says what a reflectance is."""
