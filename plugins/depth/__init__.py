"""Depth providers beside the project's own, which are in framework/depth: a file each."""
