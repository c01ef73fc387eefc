"""Scenes as data: TOML and JSON documents of built-in laws, emitters, schemes and looks, with nothing executable in them.

`files` reads bytes, `kinds` says which tables there are, `read` and `write` go between documents and scenes, `schema` prints what
is allowed, `source` is what a job renders.
"""
