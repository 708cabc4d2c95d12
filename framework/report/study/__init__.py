"""The runs of a study: read from their folders, named and ordered, with the stresses on them."""
