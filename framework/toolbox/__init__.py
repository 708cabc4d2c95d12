"""Common parts that plugins inherit or call.

`warping`: augmenters; `dropout`: dropout regularizers; `pull`, `rounds` and `bands`: capacities;
`elsewhere`: losses from other cameras; `neighbours`: nearest Gaussians.
"""
