"""Light network that ships: residual streams, gated fusion, an anchor-free head."""
