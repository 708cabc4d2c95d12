"""What the first screen says: what to use (`lead`), what stands behind it (`points`), who is
steadier (`steady`), and where a method helps along a stress (`limits`)."""
