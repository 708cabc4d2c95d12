"""The embedded scene: procedural, ray-traced, exact. It needs no download and has no unknowns.

A room corner from 2 m to 8 m: photographs bundled with scikit-image, boxes, a mirror ball, a glazed
vase, a plant, a thin lattice, wires, a plain cupboard. It is generated once per set of options and
cached, with the same bits on every machine. Poses, intrinsics and depth are exact.
"""
