"""Road users and their motion."""
