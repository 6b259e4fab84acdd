"""The nouns of the project: frozen dataclasses that check themselves."""
