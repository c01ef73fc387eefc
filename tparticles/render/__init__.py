"""From emission to pixels: camera, blackbody, look, footprints, film. Knows nothing of systems or steppers."""
