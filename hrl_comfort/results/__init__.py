"""Published results: the manifest, what is stale in it, remaking, and filling the pages."""
