"""Files: bounded readers, atomic writers, checked names, weights."""
