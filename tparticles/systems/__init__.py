"""Particle systems: their attributes, equations, births and deaths. They own the fields."""
