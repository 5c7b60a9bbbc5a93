"""Keys of configurations and words that stand for policies, for the command line and the studio."""
