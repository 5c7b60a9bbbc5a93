"""The hand: its drive, where episodes begin with it, and what sensors say of it and of the objects."""
