"""IterMVS, a learned multi-view stereo network, in plain torch on a CPU."""
