"""Learning: networks, soft actor-critic, policies and checkpoints. Knows specs only, no tasks."""
