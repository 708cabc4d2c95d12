"""Properties of names, messages and arrays."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from framework.errors import UserError, printable_line
from framework.files.arrays import read_npy
from framework.files.paths import inside


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.text(st.characters(exclude_categories=[]), max_size=80))
def test_a_name_stays_inside_its_folder_or_is_refused(name: str) -> None:
    folder = Path(__file__).parent
    try:
        path = inside(folder, name)
    except UserError as error:
        assert "\n" not in str(error)
    else:
        assert path.resolve().is_relative_to(folder)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.text(st.characters(exclude_categories=[]), max_size=3000))
def test_every_message_is_one_printable_line(text: str) -> None:
    line = printable_line(text)
    assert line.isprintable() and len(line) <= 1000
    assert str(UserError(text)) == line


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    shape=st.lists(st.integers(0, 4), max_size=4).map(tuple),
    kind=st.sampled_from(["<f4", ">f8", "<i2", "|u1", "|b1"]),
    fortran=st.booleans(),
)
def test_arrays_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, shape: tuple[int, ...], kind: str, fortran: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "array.npy"
    values = np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(kind)
    np.save(path, np.asfortranarray(values) if fortran else values)
    read = read_npy(path)
    assert read.dtype == values.dtype
    np.testing.assert_array_equal(read, values)
