"""Gaussians -> rows on the screen (`projection`), and back to the parameters (`backward`);
`fisher` pulls second moments back. The mathematics is in `ewa`, `harmonics`, `jacobian`."""
