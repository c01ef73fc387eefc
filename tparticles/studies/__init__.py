"""Studies: how accurate, how stable and how faithful the integration schemes are, measured on the engine itself.

Each study is a pure function that returns plain data; `commands` writes them as JSON and CSV, and as pictures where
matplotlib is installed. Nothing else in the package imports this.
"""
