"""A demonstration of the node: see __main__.py."""
