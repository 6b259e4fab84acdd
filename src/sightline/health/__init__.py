"""Health of sensors, measured from their output without a reference model."""
