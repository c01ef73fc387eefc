"""Regression images: small reference pictures of scenes, the rule that compares with them, and the page that shows what changed.

`check` renders and compares, `compare` takes any two pictures, folders or films, and `plugin` brings the same rule to pytest.
"""
