"""Read the uncompressed OpenEXR files that Blender writes, without a library.

Blender has no other way to hand its float buffers over when it runs without a window. One part,
scan lines, no compression, 32-bit floats: the layout of the OpenEXR file format, version 2
(openexr.com, "OpenEXR File Layout").
"""

import os
import struct

import numpy as np

_MAGIC = 20000630
_FLOAT = 2


def read_exr(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """Channels of an OpenEXR file, by name, each float32 (height, width), top row first.

    Raises
    ------
    ValueError
        If the file is of a kind that Blender does not write for this package.
    """
    with open(path, "rb") as stream:
        data = stream.read()
    magic, version = struct.unpack_from("<II", data, 0)
    if magic != _MAGIC or version & 0xFF != 2 or version & 0x1A00:
        raise ValueError(f"{path}: not a single-part scan-line OpenEXR file")
    header, offset = _header(data, 8)
    if header["compression"] != b"\0":
        raise ValueError(f"{path}: compressed")
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    names = _channels(header["channels"], path)
    # After the offset table come the lines in order: y, size, then every channel's row.
    offset += 8 * height
    line = 8 + 4 * width * len(names)
    rows = np.frombuffer(data, "<f4", height * line // 4, offset).reshape(height, line // 4)
    pixels = rows[:, 2:].reshape(height, len(names), width)
    return {name: pixels[:, k] for k, name in enumerate(names)}


def _header(data: bytes, offset: int) -> tuple[dict[str, bytes], int]:
    attributes = {}
    while data[offset]:
        end = data.index(0, offset)
        name = data[offset:end].decode()
        offset = data.index(0, end + 1) + 1  # past the name of the type
        (size,) = struct.unpack_from("<I", data, offset)
        attributes[name] = data[offset + 4 : offset + 4 + size]
        offset += 4 + size
    return attributes, offset + 1


def _channels(listing: bytes, path: str | os.PathLike) -> list[str]:
    names, offset = [], 0
    while listing[offset]:
        end = listing.index(0, offset)
        kind, _, x_sampling, y_sampling = struct.unpack_from("<iIii", listing, end + 1)
        if (kind, x_sampling, y_sampling) != (_FLOAT, 1, 1):
            raise ValueError(f"{path}: channel {listing[offset:end].decode()} is not 32-bit float")
        names.append(listing[offset:end].decode())
        offset = end + 17
    return names
