"""Files of a run folder: schemas, atomic writing, careful reading."""
