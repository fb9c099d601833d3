"""Distributions of facet normals, one a file; base.py says what a distribution knows."""
