"""One script per claim; each prints a table, then one line of JSON."""
