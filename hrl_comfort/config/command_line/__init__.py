"""What the command line and the studio know of configurations: their keys, and words that stand for policies."""
