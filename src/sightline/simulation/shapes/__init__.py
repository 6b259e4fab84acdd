"""Building blocks of meshes."""
