"""Training photos seen from elsewhere: the soft z-buffer (`zbuffer`) and its kernels."""

__all__ = ["zbuffer"]
