"""Fisher information of the Gaussians (`information`), and scores made from it (`scores`)."""
