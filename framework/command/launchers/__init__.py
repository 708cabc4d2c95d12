"""Runs on other machines: which launchers there are, and what a run takes along to where it is."""
