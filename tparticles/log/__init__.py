"""The log of a run: what every particle did, step by step, in one HDF5 file; and what is made of it without simulating again.

`sink` sends rows to the `writer`, a process of its own: a kernel at work holds Python's lock, so that a thread would wait for it.
`read` opens a log, `replay` draws it, `plot` and `export` turn it into graphs and other files.
"""
