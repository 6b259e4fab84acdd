"""Dense depth from a sparse sweep and, if there is one, an image."""
