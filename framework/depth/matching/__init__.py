"""Stereo: costs, their aggregation, the choice of depth, and the sweep over views."""
