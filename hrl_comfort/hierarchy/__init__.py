"""The hierarchy: frozen subtask policies as options, and what sequences them."""
