"""How well sensors work, told from what they deliver, without a model of it."""
