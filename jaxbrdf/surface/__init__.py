"""From measured micro-topography to the distribution of facet normals."""
