"""Other physics engines, in which a gait is replayed: MuJoCo, Drake and PyBullet, each imported when it is used."""
