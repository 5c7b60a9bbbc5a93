"""How cells differ from the model and from each other, and what disturbs them."""
