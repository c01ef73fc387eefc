"""`python -m tparticles`."""

from .cli import main

main()
