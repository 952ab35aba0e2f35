"""Engines beyond PyBullet and MuJoCo, found by name as plug-ins are."""
