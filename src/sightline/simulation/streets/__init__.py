"""Plan and ground of a street, and where objects stand."""
