"""Other physics engines, in which a gait is replayed; each is imported when it is used."""
