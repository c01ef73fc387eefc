"""The command `tparticles schema`."""

from __future__ import annotations

import json

import click

from ..command_options import stdout_kept


@click.command()
def schema() -> None:
    """Print the JSON Schema of scenes as data.

    For editors that complete and check TOML and JSON, and for programs that write scenes.
    """
    with stdout_kept():
        from .schema import schema

        found = schema()
    click.echo(json.dumps(found, indent=2, allow_nan=False))
