"""Initializers beside the project's own, which are in framework/initialize: a file each."""
