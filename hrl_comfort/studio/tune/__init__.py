"""Forms of the studio: the keys of the configuration, and trainings started from them."""
