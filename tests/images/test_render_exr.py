"""The reader of Blender's float images, against files put together byte by byte."""

import struct

import numpy as np
import pytest

from slipstitch.images.exr import read_exr


def exr(channels, compression=0, kind=2, version=2):
    height, width = next(iter(channels.values())).shape
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listing = b"".join(
        name.encode() + b"\0" + struct.pack("<iIii", kind, 0, 1, 1) for name in channels
    )
    header = b"".join(
        name + b"\0" + form + b"\0" + struct.pack("<I", len(value)) + value
        for name, form, value in (
            (b"channels", b"chlist", listing + b"\0"),
            (b"compression", b"compression", bytes([compression])),
            (b"dataWindow", b"box2i", window),
        )
    )
    lines = b"".join(
        struct.pack("<iI", y, 4 * width * len(channels))
        + b"".join(values[y].astype("<f4").tobytes() for values in channels.values())
        for y in range(height)
    )
    return struct.pack("<II", 20000630, version) + header + b"\0" + bytes(8 * height) + lines


def test_channels_come_back_by_name(tmp_path):
    rng = np.random.default_rng(1)
    channels = {name: rng.normal(size=(3, 5)).astype(np.float32) for name in ("L.B", "L.G", "L.U")}
    path = tmp_path / "a.exr"
    path.write_bytes(exr(channels))
    read = read_exr(path)
    assert list(read) == list(channels)
    for name, values in channels.items():
        np.testing.assert_array_equal(read[name], values)


@pytest.mark.parametrize(
    "change", [{"compression": 3}, {"kind": 1}, {"version": 2 | 0x1000}], ids=str
)
def test_other_layouts_are_refused(tmp_path, change):
    path = tmp_path / "a.exr"
    path.write_bytes(exr({"R": np.zeros((2, 2))}, **change))
    with pytest.raises(ValueError, match=r"a\.exr"):
        read_exr(path)
