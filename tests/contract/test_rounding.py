"""What a training computes is rounded alike by every processor: no function comes from a library
that rounds it by the processor, or by its maker (docs/bits.md)."""

import ast
from collections.abc import Iterator
from pathlib import Path

from framework.command.config.schema import ROOT

# of numbers, arrays or tensors; sums, products, quotients and NumPy's and Python's roots are exact
ROUNDED = {
    *("exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "power", "sqrt", "rsqrt"),
    *("sigmoid", "logit", "softplus", "softmax", "logsumexp", "tanh", "erf"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "arctan", "arctan2"),
    *("matmul", "mm", "bmm", "mv", "dot", "inverse", "inv", "svd", "eigh", "solve", "lstsq"),
}
OURS = {"math", "portable", "tensors", "ctx"}  # ctx.log notes a number
ACTIVATED = ("gaussians.scales", "gaussians.opacities")  # PyTorch's exponential and sigmoid
NO_TRAINING = (
    *("command", "report", "view", "exports", "records", "metrics/winograd.py", "run/trackers.py"),
    *(
        "scenes/photos",
        "scenes/placement.py",
        "scenes/cameras.py",
        "depth/network.py",
        "depth/itermvs",
        "types.py",
    ),
    # twins in PyTorch and NumPy, for tests and other devices
    *("kernels/reference.py", "backends", "train/torch_adam.py"),
    "compute/tensors.py",  # PyTorch's on other devices
)


def _trained() -> Iterator[Path]:
    for path in sorted((ROOT / "framework").rglob("*.py")):
        if not path.relative_to(ROOT / "framework").as_posix().startswith(NO_TRAINING):
            yield path
    yield from sorted((ROOT / "plugins").rglob("*.py"))


def rounded(text: str) -> list[str]:
    """What in the source `text` a library rounds by the processor."""
    actual = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            actual.append(f"line {node.lineno}: @")
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            of, name = ast.unparse(node.func.value), node.func.attr
            if name in ROUNDED and of not in OURS and (of, name) != ("np", "sqrt"):
                actual.append(f"line {node.lineno}: {of}.{name}")
        elif isinstance(node, ast.Attribute) and ast.unparse(node).endswith(ACTIVATED):
            actual.append(f"line {node.lineno}: {ast.unparse(node)}")
    return actual


def test_nothing_in_a_training_is_rounded_by_the_processor() -> None:
    actual = {str(path.relative_to(ROOT)): rounded(path.read_text("utf-8")) for path in _trained()}
    assert len(actual) > 100
    actual = {path: lines for path, lines in actual.items() if lines}
    assert not actual, f"{actual}: framework.compute.portable and tensors round alike everywhere"
