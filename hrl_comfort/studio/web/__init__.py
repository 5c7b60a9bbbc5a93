"""Page that `hrl-comfort studio export=` writes; `make page` bundles its program from `src/`."""
