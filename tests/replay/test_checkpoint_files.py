"""Checkpoint files: what is written is read, and whatever is not whole is refused."""

from __future__ import annotations

import errno
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from keeping import plain

from rtagent.checkpoint import file
from rtagent.checkpoint.file import read, write
from rtagent.errors import CheckpointError

DTYPES = st.sampled_from(["f8", "f4", "i8", "i4", "u1", "bool", ">f8"])
ARRAYS = DTYPES.flatmap(
    lambda dtype: hnp.arrays(dtype, hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=4))
)
SCALARS = st.sampled_from([np.float32(0.1), np.float64(0.1), np.int32(-3), np.bool_(True)])
NUMBERS = st.floats() | st.integers(-(1 << 130), 1 << 130) | st.booleans()
LEAVES = NUMBERS | st.text(max_size=5) | st.none() | ARRAYS | SCALARS
SAVED = st.dictionaries(
    st.text(max_size=5),
    st.recursive(LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner)),
    max_size=4,
)
SAMPLE: dict[str, Any] = {
    "weights": np.linspace(0.0, 1.0, 300).reshape(3, 100),
    "count": 7,
    "part": {"x": [1.5, None]},
}


@settings(max_examples=25, deadline=None)
@given(saved=SAVED)
def test_what_is_written_is_read_to_the_bit(saved: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("kept") / "a.ckpt"
    write(path, {"run": "one"}, saved)
    checkpoint = read(path)
    assert plain(checkpoint.saved) == plain(saved)
    assert checkpoint.about["run"] == "one"
    assert [each.name for each in path.parent.iterdir()] == ["a.ckpt"]


def test_arrays_that_are_read_can_be_written_to_and_hang_on_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    write(path, {}, {"one": np.zeros(3), "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3))})
    one, columns = (read(path).saved[name] for name in ("one", "columns"))
    one += 1.0
    assert one.flags.owndata
    assert columns.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]


@settings(max_examples=150, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
def test_a_file_with_a_byte_that_was_changed_is_refused_or_means_the_same(
    place: float, flip: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "flipped.ckpt"
    write(path, {"scenario": {"name": "x"}}, SAMPLE)
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= flip
    path.write_bytes(data)
    try:
        checkpoint = read(path)
    except CheckpointError:
        return
    assert plain(checkpoint.saved) == plain(SAMPLE)
    assert checkpoint.about["scenario"] == {"name": "x"}


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_file_that_was_cut_off_is_refused(part: float, tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    write(path, {}, SAMPLE)
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(CheckpointError, match=r"no checkpoint|cut off|damaged"):
        read(path)


def rewritten(path: Path, **entries: bytes) -> None:
    """Write the entries of a checkpoint again, some of them others."""
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in contents.items():
            archive.writestr(name, entries.get(name.split(".")[0], content))


def test_an_array_that_was_changed_with_its_checksum_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    write(path, {}, SAMPLE)
    rewritten(path, arrays=np.linspace(0.0, 2.0, 300).tobytes())
    with pytest.raises(CheckpointError, match="digest"):
        read(path)


def test_another_version_is_refused_by_its_number(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    write(path, {}, SAMPLE)
    with zipfile.ZipFile(path) as archive:
        about = json.loads(archive.read("about.json"))
    rewritten(path, about=json.dumps(about | {"version": 2}).encode())
    with pytest.raises(CheckpointError, match="version 2 of the format, and this rtagent reads version 1"):
        read(path)


@pytest.mark.parametrize(("content", "said"), [(b"", "no checkpoint"), (b"x" * 5000, "no checkpoint")])
def test_what_is_no_archive_is_refused(content: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match=said):
        read(path)


def test_another_archive_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", x=np.zeros(3))
    with pytest.raises(CheckpointError, match="zip archive, but no checkpoint"):
        read(tmp_path / "a.npz")


def test_a_file_that_is_not_there_or_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="run without --resume"):
        read(tmp_path / "none.ckpt")
    with pytest.raises(CheckpointError, match="cannot be read"):
        read(tmp_path)
    with pytest.raises(CheckpointError, match="cannot be written: No such file or directory"):
        write(tmp_path / "nowhere" / "a.ckpt", {}, SAMPLE)


def test_a_disk_that_is_full_leaves_the_checkpoint_before_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.ckpt"
    write(path, {}, SAMPLE)

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(file.os, "fsync", full)
    with pytest.raises(CheckpointError, match="cannot be written: No space left on device"):
        write(path, {}, {"count": 8})
    assert read(path).saved["count"] == 7
    assert [each.name for each in tmp_path.iterdir()] == ["a.ckpt"]


@pytest.mark.parametrize(
    "value", [object(), {1, 2}, np.array([object()]), {3: "x"}, {file.ARRAY: 1}, np.array(["x"])]
)
def test_what_is_not_plain_is_not_written(value: Any, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="a checkpoint holds"):
        write(tmp_path / "a.ckpt", {}, {"value": value})
    assert list(tmp_path.iterdir()) == []
