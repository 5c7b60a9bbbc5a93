"""Training: trainer, collector, curriculum, resume."""
