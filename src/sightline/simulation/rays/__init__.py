"""Ray casting, and surfaces hit by rays."""
